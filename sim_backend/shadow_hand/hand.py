"""The emulated hand: twenty motors, two controllers, and what they say of themselves."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from toolee_robot.sim_backend.shadow_hand.controller import Controller
from toolee_robot.sim_backend.shadow_hand.motor import Motor

_FINGERS = ("FF", "MF", "RF", "LF")
JOINTS = (
    *(f"{finger}J{joint}" for finger in _FINGERS for joint in ((1, 2, 3, 4, 5) if finger == "LF" else (1, 2, 3, 4))),
    *("THJ1", "THJ2", "THJ3", "THJ4", "THJ5", "WRJ1", "WRJ2"),
)
"""The joints; joints 1 and 2 of a finger hang on motor 0."""
_RANGES = {"J0": (0.0, 180.0), "J3": (-15.0, 90.0), "J4": (-20.0, 20.0)}
RANGES = {f"{finger}{joint}": ends for finger in _FINGERS for joint, ends in _RANGES.items()} | {
    "LFJ5": (0.0, 45.0), "THJ5": (-60.0, 60.0), "THJ4": (0.0, 70.0), "THJ3": (-12.0, 12.0), "THJ2": (-40.0, 40.0),
    "THJ1": (-15.0, 90.0), "WRJ2": (-30.0, 10.0), "WRJ1": (-40.0, 28.0),
}  # fmt: skip
"""The motors, and the ends of their ranges [deg]: published."""
NAMES = tuple(
    [f"{finger}J{joint}" for finger in _FINGERS for joint in (3, 0, 4)]
    + ["LFJ5", "THJ5", "THJ4", "THJ3", "THJ2", "THJ1", "WRJ2", "WRJ1"]
)
"""The motors, the joint that meets a handle first before the others."""
FASTEST = math.degrees(2.0)
"""Fastest speed of a finger's joint [deg/s]: of the maker's description; the thumb's are twice as fast,
and a motor of two joints moves both."""
CLOSING = {"FF": "index", "MF": "middle", "RF": "ring", "LF": "little", "TH": "thumb"}
"""Prefix of a finger's motors -> the finger."""
FLEXORS = (*(f"{finger}J{joint}" for finger in _FINGERS for joint in (3, 0)), "THJ5", "THJ2", "THJ1")
"""Motors that close a finger."""
NOISE, EFFORT_NOISE = 2e-4, 1.5
"""Standard deviations of a position [rad] and of an effort [counts]: assumed, of the order of the maker's examples."""
OFFSET = 4.0
"""Largest effort that a motor reports at rest [counts]: assumed."""
STEP = 0.002
"""Longest step of the motors [s]."""


class Hand:
    """The hand beside the rosbridge; it does not know of that. Not safe for several threads.

    Args:
        clock: Returns the time of the hand's computer [s].
        seed: Seed of the noise.

    Attributes:
        motors: The twenty motors in the order of NAMES.
        fingers: The controller of fingers and thumb.
        wrist: That of the wrist.
    """

    def __init__(self, clock: Callable[[], float], seed: int = 0) -> None:
        self._chance = random.Random(seed)
        twice = {name for name in NAMES if name.endswith("J0") or name.startswith("TH")}
        self.motors = tuple(Motor(name, *RANGES[name], (1.0 + (name in twice)) * FASTEST) for name in NAMES)
        self._motor = {motor.name: motor for motor in self.motors}
        self._rest = {motor.name: self._chance.uniform(-OFFSET, OFFSET) for motor in self.motors}
        fingers = [f"rh_{joint}" for joint in JOINTS if not joint.startswith("WR")]
        self.fingers = Controller("rh_trajectory_controller", fingers, [0.0] * len(fingers))
        self.wrist = Controller("rh_wr_trajectory_controller", ["rh_WRJ1", "rh_WRJ2"], [0.0, 0.0])
        self._clock, self._now = clock, clock()

    @property
    def now(self) -> float:
        """Time up to which it has moved [s]."""
        return self._now

    @property
    def angles(self) -> tuple[float, ...]:
        """Where the motors are now, in the order of NAMES [deg]."""
        self.run()
        return tuple(motor.position for motor in self.motors)

    @property
    def told(self) -> tuple[float, ...]:
        """Where its controllers were told last to bring their joints [rad]."""
        return (*self.fingers.desired(math.inf), *self.wrist.desired(math.inf))

    def motor(self, name: str) -> Motor:
        """One of the motors.

        Args:
            name: Its name.

        Returns:
            The motor.
        """
        return self._motor[name]

    def hold(self, met_at: float | None) -> None:
        """Put something into the hand, or take it out.

        Args:
            met_at: Angle at which the knuckles meet it [deg], 0 to 90: every other motor that closes a finger meets it
                at the same share of its range; None for nothing.
        """
        self.run()
        for name in FLEXORS:
            low, high = RANGES[name] if name == "THJ5" else (0.0, RANGES[name][1])
            self._motor[name].met_at = None if met_at is None else low + (high - low) * met_at / 90.0

    def slip(self, way: float) -> None:
        """Let what the hand holds give way.

        Args:
            way: By how much further every motor has to close to meet it [deg].
        """
        self.run()
        for motor in self.motors:
            if motor.met_at is not None:
                motor.met_at += way

    def met(self, finger: str) -> None:
        """Let a finger meet something where it is now.

        Args:
            finger: Its name; one that the hand does not have is ignored.
        """
        self.run()
        for name in FLEXORS:
            motor = self._motor[name]
            if CLOSING[name[:2]] == finger and motor.met_at is None:
                motor.met_at = motor.position

    def heat(self, degrees: float) -> None:
        """Let all motors get this hot [deg C]."""
        self.run()
        for motor in self.motors:
            motor.temperature = degrees

    def run(self) -> None:
        """Let the motors move until now."""
        end = self._clock()
        while self._now < end:
            step = min(STEP, end - self._now)
            self._now += step
            wanted: dict[str, float] = {}
            for controller in (self.fingers, self.wrist):
                if controller.running:
                    for joint, angle in zip(controller.joints, controller.desired(self._now), strict=True):
                        name = _motor_of(joint.removeprefix("rh_"))
                        wanted[name] = wanted.get(name, 0.0) + math.degrees(angle)
            for name, angle in wanted.items():
                self._motor[name].demand(angle, self._now)
            for motor in self.motors:
                motor.advance(self._now, step)

    def joints(self) -> list[tuple[str, float, float, float]]:
        """Name, position [rad], velocity [rad/s] and effort [counts] of every joint, with noise."""
        found = []
        for joint in JOINTS:
            motor = self._motor[_motor_of(joint)]
            share = 0.5 if motor.name.endswith("J0") else 1.0
            position = share * math.radians(motor.position) + self._chance.gauss(0.0, NOISE)
            velocity = share * math.radians(motor.velocity) + self._chance.gauss(0.0, 10.0 * NOISE)
            effort = motor.effort + self._rest[motor.name] + self._chance.gauss(0.0, EFFORT_NOISE)
            found.append((f"rh_{joint}", position, velocity, effort))
        return found


def _motor_of(joint: str) -> str:
    """The motor of a joint."""
    return f"{joint[:2]}J0" if joint[2:] in ("J1", "J2") and joint[:2] in _FINGERS else joint
