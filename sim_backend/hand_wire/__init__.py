"""What emulators of hands on a serial line have in common: the pseudo-terminal, the line's times and faults, events.

    with InspireEmulator() as emulator:
        serial.Serial(emulator.port)   # a driver's side

What a hand says and does is each emulator's own; none of it is the drivers'.
"""

from toolee_robot.sim_backend.hand_wire.emulator import Frame, HandEmulator
from toolee_robot.sim_backend.hand_wire.events import happen
from toolee_robot.sim_backend.hand_wire.line_faults import LineFault, LineFaults

__all__ = ["Frame", "HandEmulator", "LineFault", "LineFaults", "happen"]
