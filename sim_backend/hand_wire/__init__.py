"""What emulators of hands have in common: events, faults of the wire, pseudo-terminal or TCP connection and its times.

    with InspireEmulator() as emulator:
        serial.Serial(emulator.port)   # a driver's side

What a hand says and does is each emulator's own; none of it is the drivers'.
"""

from toolee_robot.sim_backend.hand_wire.emulator import EmulatedHand, HandEmulator
from toolee_robot.sim_backend.hand_wire.events import happen
from toolee_robot.sim_backend.hand_wire.hand_time import HandTime
from toolee_robot.sim_backend.hand_wire.line import Frame, LineEmulator
from toolee_robot.sim_backend.hand_wire.line_faults import ACKNOWLEDGE, LineFault, LineFaults, WriteFault
from toolee_robot.sim_backend.hand_wire.wires import PseudoTerminal, TcpServer, Wire, listener

__all__ = [
    "ACKNOWLEDGE",
    "EmulatedHand",
    "Frame",
    "HandEmulator",
    "HandTime",
    "LineEmulator",
    "LineFault",
    "LineFaults",
    "PseudoTerminal",
    "TcpServer",
    "Wire",
    "WriteFault",
    "happen",
    "listener",
]
