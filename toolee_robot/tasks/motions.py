"""What a task moves: the arm from one standstill to the next, with a tool only while the hand holds it."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.strike import plan_straight
from toolee_robot.errors import DeviceError, GripError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionOutcome, MotionReport, Station
from toolee_robot.tasks.observer import TaskObserver
from toolee_robot.types import Trajectory

UP = (0.0, 0.0, 1.0)
QUIET_TIME, QUIET_STEP, QUIET_PATIENCE = 0.1, 0.02, 2.0  # [s]


class Motions:
    """The arm and what it carries.

    q: joints (6,) [rad] that the arm holds; known after `begin`. X_hand_ee: 4x4, where the working end is believed to
    be. held: whether the hand has taken the tool.
    """

    q: Array

    def __init__(
        self,
        station: Station,
        config: StationConfig,
        robot: RobotModel,
        observer: TaskObserver,
        X_hand_ee: Array,
    ) -> None:
        self.X_hand_ee = X_hand_ee
        self.held = False
        self._station = station
        self._config = config
        self._robot = robot
        self._observer = observer

    def begin(self) -> None:
        """Read where the arm stands. Raises StaleDataError when it does not say."""
        self.q = self._station.arm.state().joints.q

    @property
    def q_hand(self) -> Array:
        """The hand's joints (24,) as measured now, wrist included."""
        return self._station.hand.state().joints.q

    @property
    def X_base_ee(self) -> Array:
        """The working end as believed, 4x4, where the arm stands."""
        return self._robot.X_base_ee(self.q, self.q_hand, self.X_hand_ee)

    def world(self) -> CollisionWorld:
        """What must not collide, as things are now."""
        return CollisionWorld(self._robot, self._config, self.q_hand, self.X_hand_ee if self.held else None)

    def execute(self, name: str, trajectory: Trajectory, guard: ContactGuard | None = None) -> MotionReport:
        """Move. Raises GripError when the tool is lost before or after, DeviceError when the arm was stopped."""
        self._check_grip()
        report = self._station.arm.execute(trajectory, guard)
        self.q = report.q_commanded[-1]
        self._observer.motion(name, report, self.q_hand)
        if report.outcome is MotionOutcome.STOPPED:
            raise DeviceError(f"the arm was stopped during the motion {name!r}")
        self._check_grip()
        return report

    def straight(self, name: str, direction: tuple[float, float, float], length: float) -> None:
        """Along a direction of `base` by a length [m], orientation kept."""
        if abs(length) > 1e-4:
            self.execute(name, plan_straight(self._robot, self._config, self.world(), self.q, length, direction))

    def wait_until_quiet(self, force: float) -> bool:
        """Stand until the arm has felt less than `force` [N] for QUIET_TIME: a tool that still swings would pass for a
        contact. False when it does not calm down within QUIET_PATIENCE."""
        station = self._station
        quiet = 0.0
        for _ in range(int(QUIET_PATIENCE / QUIET_STEP)):
            station.clock.sleep(QUIET_STEP)
            felt = float(np.linalg.norm(station.arm.state().wrench[:3]))
            quiet = quiet + QUIET_STEP if felt < force else 0.0
            if quiet >= QUIET_TIME:
                return True
        return False

    def stand_still(self) -> None:
        """Stop arm and fingers, as far as they can still be told; the hand keeps its grip."""
        for device in (self._station.arm, self._station.hand):
            with suppress(DeviceError):
                device.stop()

    def _check_grip(self) -> None:
        if self.held and not self._station.hand.state().holding:
            raise GripError("the hand has lost the tool: nothing moves on; pick it up and start again")
