"""The real driver on the controller stand-in, with a fault injected during a swing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tests.faults.record import MissedMomentError
from tests.rigs.joints_path import MOVING, PATIENT, Stop, stop_after
from tests.rigs.setting import Setting
from tests.rigs.strikes import Swing, plan_swing
from toolee_robot.control.motion.contact_force import strike_guard
from toolee_robot.control.motion.touch_force import forces_at_rest
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import DeviceError, LatchedError, MotionFaultError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionReport, MotionWatch
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import SafetyLimits
from toolee_robot.types import Trajectory

OFF_PATH = 5e-3  # [rad]
OFF_PATH_BY_ROBOT = 20e-3  # [rad]: an arm that is fast passes the last command and returns
FAST = 1.0  # [rad/s] of the fastest joint: what counts as mid-swing
BEFORE_CONTACT = 0.02  # [s]: near the highest speed, before the planned braking
START_TIME, SETTLE_TIME, RESET_TIME, NOTICE_TIME = 5.0, 0.6, 15.0, 0.2  # [s]
NOISE_TIME = 1.0  # [s] for which the noise of the force is measured

StopKind = Literal["program", "protective", "safeguard", "emergency"]
"""A field of `StopDecelerations`."""


@dataclass(frozen=True)
class Happening:
    """Result of a fault injected during a swing."""

    stop: Stop
    error: Exception | None
    report: MotionReport | None
    answer: object


class Rig:
    """A connected `UnsupervisedUrArm` at the start of a swing."""

    def __init__(self, controller: ControllerProcess, arm: UnsupervisedUrArm, swing: Swing, setting: Setting) -> None:
        self.controller, self.arm, self.swing, self.setting = controller, arm, swing, setting

    @property
    def name(self) -> str:
        return self.setting.name

    @property
    def strike(self) -> Trajectory:
        return self.swing.strike

    @property
    def q_commanded(self) -> Array:
        """Joint positions where the next motion starts, (6,) [rad], from a state of any age."""
        return self.arm.state(np.inf).q_commanded

    @property
    def period(self) -> float:
        return 1.0 / self.arm.rate

    def inject(
        self,
        action: Callable[[], object],
        *,
        watch: MotionWatch = PATIENT,
        guard: ContactGuard | None = None,
        execute: Callable[[Trajectory, ContactGuard | None, MotionWatch], MotionReport] | None = None,
        slow: Trajectory | None = None,
    ) -> Happening:
        """Swing, and inject a fault when the face is at its fastest."""
        path, fast = (self.strike, FAST) if slow is None else (slow, MOVING)
        # The joints lag behind the commands; the strike's planned braking begins at the contact.
        after = self.swing.plan.contact_time - BEFORE_CONTACT - self.setting.lag if slow is None else slow.duration / 2
        self.prepare()
        before = self.controller.state()["tick"]
        at, answer = [0.0], [None]
        thread = threading.Thread(target=self._act, args=(action, max(after, 0.0), at, answer))
        thread.start()
        error: Exception | None = None
        report: MotionReport | None = None
        try:
            report = (execute or self.arm.execute)(path, guard, watch)
        except DeviceError as raised:
            error = raised
            report = raised.report if isinstance(raised, MotionFaultError) else None
        thread.join()
        if isinstance(answer[0], MissedMomentError):
            raise answer[0]
        time.sleep(SETTLE_TIME)
        stop = stop_after(self.controller.trace(before), path, at[0])
        if stop.speed < fast:
            raise MissedMomentError(f"the arm moved at {stop.speed:.2f} rad/s when the fault came: too slow")
        return Happening(stop, error, report, answer[0])

    def _act(self, action: Callable[[], object], after: float, at: list[float], answer: list[object]) -> None:
        began = time.monotonic()
        while np.abs(self.controller.state()["qd"]).max() < MOVING:
            if time.monotonic() > began + START_TIME:
                return
            time.sleep(1e-3)
        time.sleep(after)
        at[0] = time.monotonic()
        try:
            answer[0] = action()
        except Exception as error:  # noqa: BLE001  (whatever it is, it is the answer)
            answer[0] = error

    def is_latched(self) -> bool:
        """Whether the next motion is refused without any movement."""
        for _ in range(2):
            q = np.array(self.controller.state()["q_target"])
            try:
                self.nudge()
            except LatchedError:
                return bool(np.abs(np.array(self.controller.state()["q_target"]) - q).max() < 1e-9)
            except MotionFaultError:
                continue
            except DeviceError:
                return False
            return False
        return False

    def off_path(self, path_time: float, by_robot: StopKind | None, notice: float) -> float:
        """Largest distance of the joints from the swing's path that a stop may bring."""
        rounding = self.setting.rounding(self.strike)
        if by_robot is None:
            return OFF_PATH + rounding
        if by_robot == "program":  # after the watchdog's time, when the arm has come to rest at the last command
            return OFF_PATH_BY_ROBOT + rounding
        deceleration = float(getattr(self.setting.stops, by_robot))
        return OFF_PATH + rounding + self.setting.straight_on(self.strike, path_time, notice, deceleration)

    def make_ready(self) -> None:
        """Clear the robot as a person would, then reset the arm."""
        self.controller.fault("reset")
        time.sleep(NOTICE_TIME)  # the reset ends the robot's program, which the arm has to see first
        deadline = time.monotonic() + RESET_TIME
        while True:
            try:
                self.arm.reset()
                return
            except DeviceError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)

    def prepare(self) -> None:
        """Make the arm ready and move it to the start of the swing; see `go_to_start`."""
        self.make_ready()
        self.go_to_start()

    def go_to_start(self) -> None:
        """Move to the start of the swing."""
        limits = self.swing.config.arm
        way = joint_move(
            self.q_commanded,
            self.strike.q[0],
            0.5 * np.asarray(limits.velocity),
            np.full(6, limits.transfer_acceleration),
            np.full(6, limits.jerk),
        )
        try:
            self.arm.execute(way, None, PATIENT)
        except MotionFaultError as error:
            raise MissedMomentError(f"the arm was stopped before the fault came: {error}") from error

    def contact_guard(self) -> ContactGuard:
        """Contact detection of the swing, as a job makes it: its threshold bears the noise that is measured here."""
        forces = forces_at_rest(self.arm, HostClock(), NOISE_TIME)
        return strike_guard(self.swing.config.strike, self.swing.plan.contact_time, forces, self.arm.rate)

    def nudge(self) -> None:
        """Move every joint a little, from where the next motion starts; raises what `execute` raises."""
        q, limits = self.q_commanded, self.swing.config.arm
        move = joint_move(q, q + 0.02, np.full(6, 0.2), np.full(6, 1.0), np.full(6, limits.jerk))
        self.arm.execute(move, None, PATIENT)


@contextmanager
def rig(setting: Setting, limits: SafetyLimits | None = None) -> Iterator[Rig]:
    """Context with a stand-in, the driver connected to it, and a planned swing."""
    swing = plan_swing(setting.model)
    with (
        setting.start(swing.plan.strike.q[0], limits) as controller,
        UnsupervisedUrArm(UrArmConfig(setting.host, setting.servo), swing.config.arm) as arm,
    ):
        yield Rig(controller, arm, swing, setting)
