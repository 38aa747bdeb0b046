"""What emulators of hands on a wire have in common: events, faults of the wire, a pseudo-terminal.

    with InspireEmulator() as emulator:
        serial.Serial(emulator.port)   # a driver's side

What a hand says and does is each emulator's own; none of it is the drivers'.
"""

from toolee_robot.sim_backend.hand_wire.emulator import HandEmulator
from toolee_robot.sim_backend.hand_wire.events import happen
from toolee_robot.sim_backend.hand_wire.line_faults import LineFault, LineFaults
from toolee_robot.sim_backend.hand_wire.serial_line import Frame, SerialEmulator

__all__ = ["Frame", "HandEmulator", "LineFault", "LineFaults", "SerialEmulator", "happen"]
