"""An arm on paper: it follows anything exactly and checks nothing, so what a supervisor lets through shows."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np

from tests.rigs.people import People
from toolee_robot.control.motion.path_stop import stop_on_path
from toolee_robot.errors import DeviceError, MotionFaultError, StaleDataError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ArmStatus, ContactGuard, MotionOutcome, MotionReport, MotionWatch
from toolee_robot.types import JointState, Payload, Trajectory

STOP_ACCELERATION, STOP_JERK = 15.0, 1500.0


class PaperArm:
    """An arm on paper that drives each sample exactly; tests set its faults, pauses and contacts."""

    rate = 125.0

    def __init__(self, q: Array) -> None:
        self.q = np.array(q)
        self.driven: list[Array] = []
        self.watches: list[MotionWatch | None] = []
        self.moves: list[Trajectory] = []
        self.tick: Callable[[], None] = lambda: None
        self.fault: type[MotionFaultError] | None = None
        self.pause, self.lag = 0.0, 0.0
        self.meets: float | None = None
        self.fresh = True
        self.status = ArmStatus.READY
        self.measured_off = np.zeros(6)
        self.resets, self.zeroed = 0, 0
        self._stop = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def state(self, max_age: float = 0.1) -> ArmState:
        if not self.fresh:
            raise StaleDataError(f"nothing for {max_age} s: check the link")
        joints = JointState(self.q + self.measured_off, np.zeros(6), 0.0)
        return ArmState(joints, self.q.copy(), np.zeros(6), self.status)

    def execute(
        self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport:
        self.watches.append(watch)
        self.moves.append(trajectory)
        self._stop = False
        begun = len(self.driven)
        contact, outcome = None, MotionOutcome.COMPLETED
        period = 1 / self.rate
        t = 0.0
        fault = self.fault
        for k in range(1, int(np.ceil(trajectory.duration * self.rate - 1e-9)) + 1):
            t = min(k * period, trajectory.duration)
            self._go(trajectory.sample(t)[0])
            if guard is not None and self.meets is not None and t >= self.meets * trajectory.duration:
                outcome = MotionOutcome.CONTACT
                contact = JointState(trajectory.sample(t - self.lag)[0], np.zeros(6), t)
                break
            if self._stop or (fault is not None and t > trajectory.duration / 2):
                outcome = MotionOutcome.STOPPED
                break
        for q, _ in stop_on_path(trajectory, t, period, STOP_ACCELERATION, STOP_JERK):
            self._go(q)
        rows = np.array(self.driven[begun:])
        stamps = np.array([k * period for k in range(len(rows))])
        report = MotionReport(outcome, stamps, rows, rows, np.zeros((len(rows), 6)), contact)
        if fault is not None:
            raise fault("it failed", report)
        return report

    def _go(self, q: Array) -> None:
        self.q = np.array(q)
        self.driven.append(self.q)
        self.tick()
        if self.pause:
            time.sleep(self.pause)

    def set_payload(self, payload: Payload) -> None:
        self.payload = payload

    def zero_wrench(self) -> None:
        self.zeroed += 1

    def stop(self) -> None:
        self._stop = True

    def reset(self) -> None:
        if self.status is not ArmStatus.READY:
            raise DeviceError("the robot is not ready")
        self.fault = None
        self.resets += 1


class Bystander(People):
    """A person who is where a test puts them, with the hold-to-run switch in the hand."""

    def __init__(self) -> None:
        super().__init__()
        self.here, self.holds, self.late = False, True, False

    def zone_occupied(self) -> bool:
        return self.here or self.late

    def readings_certain(self) -> bool:
        return not self.late

    def hold_to_run_held(self) -> bool:
        return self.holds and not self.late
