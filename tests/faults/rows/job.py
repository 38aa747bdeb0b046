"""Faults of hand, camera, perception, nail, person and arm under the real job on the simulated station.

Poses come from the ground truth, since these rows do not examine the perception.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tests.faults.record import FaultRow, Measurement
from tests.faults.rows.job_fault import IN_STRIKE, JobFault, Scene
from tests.faults.rows.job_faults import JOB_FAULTS
from tests.rigs.driver_rig import OFF_PATH
from tests.rigs.job_rig import CONFIG, Bench, ClosedHand, Log, at_rest, grip_kept
from tests.rigs.joints_path import JointWatch, Stop
from tests.rigs.people import ScriptedPerception
from toolee_robot.control.motion.path_stop import stop_on_path
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.errors import DeviceError, LatchedError
from toolee_robot.hal import MotionOutcome, RgbdCamera
from toolee_robot.sim_backend.devices.arm import RATE
from toolee_robot.tasks.common.outcome import HammerResult, Outcome, Stage
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.types import Trajectory

ON = f"simulated {CONFIG.arm.model}, {RATE:.0f} Hz"
"""One arm, that of the default station: driver and controller, in which the models differ, are in the arm's part."""
SETTLING = 0.05  # [s] until the simulated motors have come to rest after the last command
OFF_PATH_BY_MOTORS = 0.02  # [rad]: at a contact, the simulated motors give way
AWAY, HIGHER = 0.05, 0.10  # [m] that a retreat must bring at least: from the person's place, and up
STILL = 2e-3  # [rad]


def job_rows(bench: Bench) -> Iterator[Measurement]:
    """Yield each fault in a job of its own, on a station that is restored in between."""
    for fault in JOB_FAULTS:
        run = partial(job_row, fault, bench)
        yield Measurement(fault.number, fault.fault, fault.phase, ON, fault.expected, run)


def job_row(
    fault: JobFault, bench: Bench, hand: ClosedHand | None = None, camera: RgbdCamera | None = None
) -> FaultRow:
    """Measure one fault in one job."""
    if hand is None and camera is None:
        bench.reset()
    if hand is not None:
        bench.hand = hand
    if camera is not None:
        bench.camera = camera
    scene = Scene(bench, Log(), ScriptedPerception(bench.sim.judge))
    try:
        return _Row(fault, scene).measure()
    finally:
        for undo in scene.undo:
            undo()


class _Row:
    """One job with one fault."""

    _strike: Trajectory

    def __init__(self, fault: JobFault, scene: Scene) -> None:
        self._fault, self._scene = fault, scene
        self._bench, self._log = scene.bench, scene.log
        self._world = scene.bench.sim.world
        self._hand = self._world.X_base_hand()[:3, 3]
        self._watch = JointWatch(self._world, scene.bench.arm)
        self._real_time = ExitStack()
        self.wrong: list[str] = []

    def measure(self) -> FaultRow:
        fault = self._fault
        self._prepare()
        task = self._task()
        with self._real_time:
            result = task.run()
        stands = at_rest(self._bench.sim)
        self._check_end(result, stands)
        measured = self._check_braking()
        job_latched, arm_latched = bool(task.latched), self._arm_refuses()
        self._check_latches(job_latched, arm_latched)
        if fault.resumes:
            self._check_resume(task)
        elif arm_latched:
            self._check_reset()
        return FaultRow(
            fault.number, fault.fault, fault.phase, ON, fault.expected, result.outcome.replace("_", " "),
            job_latched or arm_latched, not self.wrong, "; ".join(self.wrong), **measured,
        )  # fmt: skip

    def _prepare(self) -> None:
        """Register the actions during the job, including the fault."""
        fault, log = self._fault, self._log
        if fault.prepare is not None:
            fault.prepare(self._scene)
        log.after["strike"] = self._after_strike
        if fault.when is None:
            self._inject()
        elif isinstance(fault.when, Stage):
            log.at[fault.when] = self._inject
        log.after["to the run-up"] = self._before_strike

    def _task(self) -> HammeringTask:
        fault = self._fault
        task = replace(
            CONFIG.task, max_strikes=fault.max_strikes, views_again=1, strikes_between_looks=1, min_progress=5e-4
        )
        config = replace(CONFIG, task=task)
        if fault.sees:
            return self._bench.seeing_task(self._log, config, self._scene.perception)
        return self._bench.blind_task(self._log, config)

    def _inject(self) -> None:
        self._hand = self._world.X_base_hand()[:3, 3]
        if self._scene.happened is None and self._fault.when == IN_STRIKE:
            self._scene.happened = self._world.time
        self._fault.inject(self._scene)

    def _before_strike(self) -> None:
        plan = self._log.plan
        assert plan is not None
        if self._fault.when == "to the run-up":
            self._inject()
        if self._fault.when == IN_STRIKE:
            # Hand and people are watched by threads, which run in real time.
            self._real_time.enter_context(self._bench.in_real_time())
            self._watch.at(self._world.time + max(plan.contact_time - self._fault.before, 0.05), self._inject)
        self._strike = self._bench.bounded(plan.strike)
        self._watch.begin()

    def _after_strike(self) -> None:
        self._real_time.close()
        self._watch.end()
        self._hand = self._world.X_base_hand()[:3, 3]
        if self._fault.when == "strike":
            self._inject()

    # -- requirements ---------------------------------------------------------------------------------------------

    def _check(self, good: bool, otherwise: str) -> None:
        if not good:
            self.wrong.append(otherwise)

    def _check_end(self, result: HammerResult, stands: bool) -> None:
        fault, log = self._fault, self._log
        self._check(result.outcome is fault.outcome, f"{fault.outcome} expected, got {result.outcome}")
        self._check(not result.success, "a failure was recorded as success")
        self._check(fault.message in result.reason, f"the reason does not say {fault.message!r}: {result.reason}")
        code = "" if result.fault is None else result.fault.code
        self._check(fault.code in ("", code), f"{fault.code} expected, got {code or 'no error'}")
        self._check(log.last is result, "the end was not recorded")
        last = log.motions[-1] if log.motions else None
        self._check(last == fault.last, f"the last motion was {last!r}, not {fault.last!r}")
        strikes = log.motions.count("strike")
        self._check(strikes == fault.swings, f"{strikes} strikes were swung, {fault.swings} may be")
        self._check(stands, "the arm does not stand")
        self._check(grip_kept(self._bench.sim) is fault.keeps, "the hand let go" if fault.keeps else "nothing dropped")
        again = any("looking again" in message for message in log.messages)
        self._check(again is fault.looks_again, "it did not look again" if fault.looks_again else "it looked again")
        if fault.meetings is not None:
            got = tuple(strike.meeting for strike in result.strikes)
            self._check(got == fault.meetings, f"the strikes met {', '.join(got)}, not {', '.join(fault.meetings)}")
        if fault.last == "retreat":
            self._check_retreat()

    def _check_retreat(self) -> None:
        before, after = self._hand, self._world.X_base_hand()[:3, 3]
        person = np.array(CONFIG.scene.person_center)
        further = float(np.linalg.norm((after - person)[:2]) - np.linalg.norm((before - person)[:2]))
        self._check(further > AWAY, f"the hand is {further:.3f} m further from the person only")
        self._check(after[2] - before[2] > HIGHER, f"the hand is {after[2] - before[2]:.3f} m higher only")

    def _check_braking(self) -> dict[str, Any]:
        """Check the disturbed strike; returns the measured fields of the `FaultRow`."""
        fault, happened = self._fault, self._scene.happened
        if happened is None:
            self._check(fault.braking is None and fault.when != IN_STRIKE, "the fault did not come")
            return {}
        strike, braking = self._strike, fault.braking
        arm_off = braking is not None and braking.arm_off
        stop = self._watch.stop(strike, happened, commanded=arm_off)
        off_path = stop.off_path
        self._check(stop.off_path < OFF_PATH, f"the set-point left the path by {stop.off_path:.4f} rad")
        if not arm_off:
            off_path = self._watch.off_path(strike, happened)
            self._check(off_path < OFF_PATH_BY_MOTORS, f"the joints left the path by {off_path:.4f} rad")
        measured: dict[str, Any] = {"speed": stop.speed, "off_path": off_path}
        if braking is not None:
            self._check(stop.reached < strike.duration - 2 / RATE, "the strike went on to its end")
        if braking is not None and braking.cycles is not None:
            allowed = self._allowed(strike, stop, braking.cycles)
            self._check(stop.standstill <= allowed, f"standstill after {stop.standstill:.3f} s, {allowed:.3f} allowed")
            measured |= {"reaction": stop.reaction, "standstill": stop.standstill, "allowed": allowed}
        return measured

    @staticmethod
    def _allowed(strike: Trajectory, stop: Stop, cycles: float) -> float:
        limits, notice = CONFIG.arm, cycles / RATE
        braking = stop_on_path(strike, stop.path_time + notice, 1 / RATE, limits.stop_acceleration, limits.stop_jerk)
        return notice + (len(list(braking)) + 2) / RATE + SETTLING

    # -- the latch -----------------------------------------------------------------------------------------------------

    def _check_latches(self, job: bool, arm: bool) -> None:
        fault = self._fault
        self._check(job is fault.job_latches, "the job's supervisor " + ("latched" if job else "did not latch"))
        self._check(arm is fault.arm_latches, "the arm " + ("refuses to move" if arm else "did not refuse to move"))

    def _arm_refuses(self) -> bool:
        """Whether the arm itself refuses a small motion, without moving."""
        before = self._world.robot.arm_state()[0]
        try:
            self._nudge()
        except LatchedError:
            return bool(np.abs(self._world.robot.arm_state()[0] - before).max() < STILL)
        except DeviceError:
            return False
        return False

    def _check_reset(self) -> None:
        """Check that only a person's reset clears the latch."""
        arm = self._bench.arm
        if self._fault.person:
            try:
                arm.reset()
                self.wrong.append("it was reset before anybody had made the robot ready")
            except DeviceError:
                pass
        arm.make_ready()
        arm.restore_link()
        arm.reset()
        self._check(self._nudge() is MotionOutcome.COMPLETED, "it does not move after the reset")

    def _check_resume(self, task: HammeringTask) -> None:
        """Check that the job goes on with the tool in the hand, only after a person, and ends as any job."""
        bench, log = self._bench, self._log
        before = len(log.motions)
        self._check(task.resumable, "the job cannot be resumed")
        try:
            task.resume()
            self.wrong.append("it was resumed without a confirmation")
        except DeviceError:
            pass
        if self._fault.person:
            task.resume(confirmed=True)
            self._check(task.resumable and len(log.motions) == before, "it went on before anybody had made it ready")
        bench.arm.make_ready()
        bench.arm.restore_link()
        bench.people.is_inside = False
        result = task.resume(confirmed=True)
        went = log.motions[before:]
        self._check(result.outcome is Outcome.OUT_OF_STRIKES, f"resumed, it ended as {result.outcome}: {result.reason}")
        self._check(went.count("strike") == 1 and went[-1:] == ["home"], f"resumed, it moved {', '.join(went)}")
        self._check("to a view" in went, "resumed, it did not look at the tool again")
        self._check(at_rest(bench.sim) and grip_kept(bench.sim), "resumed, it ended without the tool or in motion")

    def _nudge(self) -> MotionOutcome:
        q = self._bench.arm.q_commanded
        way = joint_move(q, q + 0.02 * np.eye(6)[0], np.full(6, 0.2), np.full(6, 1.0), np.full(6, CONFIG.arm.jerk))
        return self._bench.arm.execute(way).outcome
