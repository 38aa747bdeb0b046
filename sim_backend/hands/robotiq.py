"""Emulator of a Robotiq 2F-85 or 2F-140 behind the socket of its URCap, for drivers that speak to port 63352.

    with RobotiqEmulator() as emulator:
        emulator.hold(120)   # a handle, met by the jaws at 120 of 255

It is written from the maker's instruction manual and Universal Robots' script manual, not from the project's driver.
What it does is

- published: the variables and their values, 3 and 230 as ends of the way, 20 to 150 mm/s of a 2F-85's 85 mm, "ack";
- assumed: 3 ms for a reply, how far it presses into what it holds, 85 deg C as its fault's temperature.

Not there: activation, automatic release, current (it is activated; its force makes no difference).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from toolee_robot.robots.hands.robotiq import OPEN, SHUT, joints_of_position
from toolee_robot.sim_backend.hands.kit import (
    Address,
    EmulatedHand,
    HandEmulator,
    HandTime,
    LineEmulator,
    LineFaults,
    Motor,
    TcpServer,
)
from toolee_robot.station import HandConfig

HOT = 85.0
"""Temperature at which it has a fault [deg C]."""
SLOWEST, FASTEST = 53.0, 400.0
"""Speeds at SPE 0 and 255 [of 255 a second]."""
PRESSED = 2.0
"""Way by which it presses into what it holds [of 255]."""


@dataclass
class Jaws(Motor):
    """The one motor [of 255].

    Attributes:
        reaction: See `Motor`: assumed.
        position: See `Motor`.
        speed: Speed as commanded [of 255].
    """

    reaction: ClassVar[float] = 0.02
    position: float = OPEN
    speed: float = 255.0
    contact: int = 3
    """OBJ."""

    def move(self, now: float, step: float) -> None:  # noqa: ARG002
        """Go to the target, until something is in the way."""
        if self.target is None:
            return
        way = float(np.clip(self.target, OPEN, SHUT)) - self.position
        most = (SLOWEST + (FASTEST - SLOWEST) * self.speed / 255.0) * step
        held = way > 0.0 and self.met_at is not None and self.position >= self.met_at + PRESSED
        if abs(way) < 0.5:
            self.contact = 3
        elif self.jammed or held or self.temperature >= HOT:
            self.contact = 2 if way > 0.0 else 1
        else:
            self.contact = 0
            self.position += min(max(way, -most), most)


class RobotiqEmulator(LineEmulator[EmulatedHand[Jaws]]):
    """A Robotiq gripper that a driver finds at `port`.

    Args:
        name: The gripper's name in a station file.
        address: Host and port to listen at; port 0 for a free one.
        seed: Seed of the line's noise.
        pace: Rate of the motor's time relative to the host's.

    Raises:
        UserError: It cannot listen there.
    """

    label = "Robotiq 2F gripper behind its URCap"
    most = 255.0
    motors = ("jaws",)
    fingers = {"left": ("jaws",), "right": ("jaws",)}  # noqa: RUF012
    events = "heat DEGREES, jam jaws, free jaws"

    def __init__(
        self, name: str = "robotiq_2f85", address: Address = ("127.0.0.1", 0), seed: int = 0, pace: float = 1.0
    ) -> None:
        clock = HandTime(pace)
        hand = EmulatedHand(clock, [Jaws()], [0])
        faults = LineFaults(lambda _: b"PRE 17\n", seed, framing=3)
        super().__init__(hand, TcpServer(address, 0.0), faults, clock, 0.003, 1e-7)
        self.joints = lambda angles: joints_of_position(name, float(angles[0]))
        self._registers = {"ACT": 1, "GTO": 0, "STA": 3, "SPE": 255, "FOR": 255, "PRE": 0}

    def answer(self, data: bytes) -> list[bytes]:
        """Answer the requests in the stream of bytes."""
        *lines, self.stream = (self.stream + data).split(b"\n")
        return [reply for line in lines for reply in self._carry_out(line.decode(errors="replace").split())]

    def _carry_out(self, words: list[str]) -> list[bytes]:
        self._hand.run()
        (jaws,) = self._hand.motors
        if len(words) == 2 and words[0] == "GET":
            fault = 8 if jaws.temperature >= HOT else 0
            now = self._registers | {"POS": round(jaws.position), "OBJ": jaws.contact, "FLT": fault}
            return [f"{words[1]} {now[words[1]]}\n".encode()] if words[1] in now else []
        if not words or words[0] != "SET" or len(words) % 2 == 0:
            return []
        return self._set(dict(zip(words[1::2], map(int, words[2::2]), strict=True)))

    def _set(self, values: dict[str, int]) -> list[bytes]:
        (jaws,) = self._hand.motors
        self._registers |= {"PRE" if name == "POS" else name: value for name, value in values.items()}
        jaws.speed = self._registers["SPE"]
        if self._registers["GTO"] == 0:
            jaws.target, jaws.contact = None, 3
        elif "POS" in values:
            jaws.contact = 0
            jaws.go(float(values["POS"]), self._hand.now)
        return [b"ack"]


def emulate(config: HandConfig, listen: Address, seed: int, pace: float) -> HandEmulator[Any]:
    """Build the emulator of a station's gripper."""
    return RobotiqEmulator(config.model, listen, seed, pace)
