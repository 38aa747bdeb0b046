"""Driver of a Robotiq 2F-85 or 2F-140 by the socket of its URCap: port 63352 of the arm's controller.

    with RobotiqGripper(hand_model(config.hand), "tcp://192.168.56.101:63352", HostClock()) as hand:
        hand.open()

Variables and their values are those of the maker's "2F-85 & 2F-140 Instruction Manual", sections 4.3 and 4.4, whose
registers the URCap's socket has by name; requests and replies those of `socket_get_var` and `socket_set_var` in
Universal Robots' script manual, with "ack" for a SET (dof.robotiq.com/discussion/1962). No code here was ever run on
such a gripper.
"""

from __future__ import annotations

import re

import numpy as np

from toolee_robot.devices.hands import WiredHandKind
from toolee_robot.devices.hands.grip import GripRule, Reading
from toolee_robot.devices.hands.polled import PolledHand
from toolee_robot.devices.hands.ports import PortLine, TcpPort
from toolee_robot.errors import DeviceError, NoAnswerError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.robots import HandModel
from toolee_robot.robots.hands.robotiq import OPEN, SHUT, SIZES, joints_of_position
from toolee_robot.station import HandConfig

ANSWER_S = 0.05
"""Time for a reply: assumed."""
ATTEMPTS = 3
ACTIVE = 3
"""STA of an activated gripper."""
MOVING, BLOCKED, GRIPS = 0, 1, 2
"""OBJ: on the way, in contact while opening, in contact while closing; 3 is at the requested position."""
FAULTS = {
    5: ("device.hand_inactive", "activation is not complete", "activate it at the pendant"),
    7: ("device.hand_inactive", "not activated", "activate it at the pendant"),
    8: ("device.hand_over_temperature", "too hot", "let it cool down"),
    9: ("device.hand_communication", "no communication for 1 s", "look at its cable"),
    10: ("device.hand_motor", "under voltage", "look at its supply"),
    11: ("device.hand_inactive", "automatic release", "activate it at the pendant"),
    12: ("device.hand_motor", "internal fault", "have it repaired"),
    13: ("device.hand_inactive", "activation failed", "see what blocks it, then activate it at the pendant"),
    14: ("device.hand_over_current", "over current", "see what blocks it, then activate it at the pendant"),
    15: ("device.hand_inactive", "automatic release is complete", "activate it at the pendant"),
}
"""FLT -> code of the error, description, remedy (manual, section 4.4.3)."""
FULL, CLOSING_SPEED = 255, 64
"""Speed and force at most, and the speed of closing [of 255]."""
OPENED = OPEN + 12.0
"""Position up to which it is open [of 255]."""
STILL = 1.0
"""Way that counts as none [of 255]; at the slowest speed it is 5 within STANDS_S."""
RULE = GripRule((1,), 0, touches=1.0, shut=SHUT - 4.0, slipped=8.0, unit="of 255", least=1)
"""A grip, of both jaws alike: it grips by its own judgement, and is not shut; 8 are 3 mm of a 2F-85."""


class RobotiqLine(PortLine):
    """The URCap's socket. TCP keeps the order of replies, and each names its variable."""

    def __init__(self, port: str) -> None:
        super().__init__(TcpPort(port, ANSWER_S), ANSWER_S)

    def get(self, name: str) -> int:
        """Read a variable.

        Raises:
            NoAnswerError: The gripper does not answer, or the connection is gone.
        """
        return int(self._ask(f"GET {name}", rf"{name} (\d+)\r?\n"))

    def set(self, **values: int) -> None:
        """Write variables, and see that acknowledged.

        Raises:
            NoAnswerError: The gripper does not answer, or the connection is gone.
        """
        self._ask("SET " + " ".join(f"{name} {value}" for name, value in values.items()), "(ack)")

    def _ask(self, request: str, reply: str) -> bytes:
        for _ in range(ATTEMPTS):
            found = self.ask(f"{request}\n".encode(), lambda received: re.search(reply.encode(), received))
            if found is not None:
                return found[1]
        message = f"no gripper answers {request!r} at {self._port.path}: see that its URCap is installed and sees the"
        raise NoAnswerError(f"{message} gripper, and that no other program commands it", code="no_answer.hand_silent")


class RobotiqGripper(PolledHand[RobotiqLine, int]):
    """A Robotiq 2F-85 or 2F-140; use it in its `with` block. Entering it moves nothing: a person activates it before.

    It presses with its full force, and goes on without being told. `Reading.said` is OBJ. Two pads do not hold a hammer
    that strikes against turning: use a mount.

    Args:
        model: The gripper: `hand_model(config.hand)`.
        port: `tcp://HOST:63352`, the arm's controller.
        clock: Clock of the station, the host's.
    """

    def __init__(self, model: HandModel, port: str, clock: Clock) -> None:
        super().__init__(model, clock, RULE, STILL)
        self._port, self._force = port, SIZES[model.name].force

    def _spread(self, reading: Reading[int]) -> tuple[Reading[int], list[str]]:
        self._go(0, FULL)
        reading = self._until_still(settled=lambda reading: reading.said != MOVING)
        return reading, ["jaws"] if reading.closures[0] > OPENED else []

    def _grasp(self, reading: Reading[int]) -> tuple[Reading[int], list[str]]:
        self._go(FULL, CLOSING_SPEED)
        reading = self._until_still(settled=lambda reading: reading.said != MOVING)
        return reading, ["jaws"] if reading.closures[0] <= OPENED else []

    def _go(self, position: int, speed: int) -> None:
        def go(line: RobotiqLine) -> None:
            if not self._stopped.is_set():
                line.set(POS=position, SPE=speed, FOR=FULL, GTO=1)

        self._tell(go)

    def _connect(self) -> RobotiqLine:
        return RobotiqLine(self._port)

    def _read(self, line: RobotiqLine) -> Reading[int]:
        stamp = self._clock.now()
        if not self.readings and line.get("STA") != ACTIVE:
            message = "the gripper is not activated: activate it at the pendant, where it opens and closes once"
            raise DeviceError(message, code="device.hand_inactive")
        position, contact, fault = line.get("POS"), line.get("OBJ"), line.get("FLT") & 0xF
        pressing = self._force if contact == GRIPS else 0.0
        error, words = None, ""
        if fault:
            code, words, remedy = FAULTS.get(fault, ("device.hand_motor", f"fault {fault}", "look at its manual"))
            error = DeviceError(f"the gripper reports a fault ({words}): {remedy}; it keeps its grip", code=code)
        return Reading(stamp, np.full(2, float(position)), np.full(2, pressing), contact, error, words)

    def _watch(self, reading: Reading[int], line: RobotiqLine) -> None:  # noqa: ARG002
        self._grip.follow(reading)  # it closes further by itself

    def _freeze(self, line: RobotiqLine) -> None:
        if self._recent[-1].said == MOVING:
            line.set(GTO=0)

    def _positions(self, reading: Reading[int]) -> Array:
        return joints_of_position(self._model.name, reading.closures[0])

    def _newtons(self, reading: Reading[int]) -> dict[str, float]:
        return dict.fromkeys(("left", "right"), float(reading.forces[0]))  # as commanded: it measures none


def _build(model: HandModel, port: str, _: HandConfig, clock: Clock) -> RobotiqGripper:
    return RobotiqGripper(model, port, clock)


KIND = WiredHandKind(_build, "the arm's controller, tcp://HOST:63352", "tcp", serial=False)
