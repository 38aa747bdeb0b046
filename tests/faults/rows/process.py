"""Faults of the task's own process (Ctrl-C, SIGKILL, a stall), after which the servo process must stop the arm."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.arm import AT_REST, HEARTBEAT
from tests.faults.rows.released_stops import travel
from tests.rigs.driver_rig import BEFORE_CONTACT, OFF_PATH, SETTLE_TIME, START_TIME, Rig
from tests.rigs.joints_path import MOVING, PATIENT, stop_after
from tests.rigs.setting import Setting
from tests.rigs.strikes import plan_swing
from toolee_robot.errors import DeviceError, MotionFaultError, TooleeError, TrackingError
from toolee_robot.hal import MotionOutcome
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import profile as profile_of

HEARTBEAT_PERIOD = 0.02  # [s] between two heartbeats


@dataclass(frozen=True)
class TaskFault:
    """A fault of the task's process."""

    fault: str
    signal: signal.Signals
    notice: float


TASK_FAULTS = (
    # The interpreter handles a signal between two bytecodes.
    TaskFault("task gets Ctrl-C", signal.SIGINT, 0.02),
    # The kernel reports it at once: `OwnerWatch`.
    TaskFault("task killed (SIGKILL)", signal.SIGKILL, 0.002),
    TaskFault("task stalls (SIGSTOP)", signal.SIGSTOP, HEARTBEAT + HEARTBEAT_PERIOD),
)


def process_rows(setting: Setting) -> Iterator[Measurement]:
    """Yield each fault in mid-swing and at rest, each with its own task and stand-in."""
    for fault in TASK_FAULTS:
        for phase in (Phase.SWING, Phase.REST):
            run = partial(_row, fault, phase, setting)
            yield Measurement(11, fault.fault, phase, setting.name, "brakes on the path", run)


def _row(fault: TaskFault, phase: Phase, setting: Setting) -> FaultRow:
    swing, name = plan_swing(setting.model), setting.name
    strike, limits = swing.plan.strike, swing.config.arm
    task_arguments = (setting.host, setting.model.value, setting.profile)
    with setting.start(strike.q[0]) as controller:
        task = subprocess.Popen(
            [sys.executable, "-m", "tests.rigs.strikes", *task_arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        try:
            assert task.stdin is not None
            assert task.stdout is not None
            if task.stdout.readline().strip() != "ready":
                raise DeviceError("the task did not get ready")
            before = controller.state()["tick"]
            if phase is Phase.SWING:
                task.stdin.write("go\n")
                task.stdin.flush()
                _await_motion(controller)
                time.sleep(swing.plan.contact_time - BEFORE_CONTACT - setting.lag)
            at = time.monotonic()
            task.send_signal(fault.signal)
            time.sleep(1.0 + SETTLE_TIME)
            trace = controller.trace(before)
            program_ended = controller.state()["program_state"] != "PLAYING"
            said = _continued(task) if fault.signal is signal.SIGSTOP and phase is Phase.SWING else ""
        finally:
            task.kill()
            task.wait()
    if phase is Phase.REST:
        moved = float(np.ptp(trace.q_target, axis=0).max())
        wrong = [] if moved < AT_REST else [f"the arm moved by {moved:.4f} rad"]
        got = "stands still, program ended" if program_ended else "stands still"
        return FaultRow(
            11, fault.fault, phase, name, "stands still", got, program_ended, not wrong, "; ".join(wrong),
            off_path=moved,
        )  # fmt: skip
    stop = stop_after(trace, strike, at)
    allowed = fault.notice + setting.braking(strike, stop.path_time, fault.notice, limits) + 2 * setting.period
    wrong = []
    latched = program_ended or said == MotionFaultError.__name__
    if not latched:
        wrong.append("the robot's program runs on, and the task was told nothing")
    if stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if stop.off_path > OFF_PATH + setting.rounding(strike):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    got = "at rest, program ended" if program_ended else f"at rest, then {said}"
    return FaultRow(
        11, fault.fault, phase, name, "brakes on the path", got, latched, not wrong, "; ".join(wrong),
        stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip


def _continued(task: subprocess.Popen[str]) -> str:
    """Continue the task and read the outcome of its motion."""
    assert task.stdout is not None
    task.send_signal(signal.SIGCONT)
    return task.stdout.readline().strip()


def _await_motion(controller: ControllerProcess) -> None:
    began = time.monotonic()
    while np.abs(controller.state()["qd"]).max() < MOVING:
        if time.monotonic() > began + START_TIME:
            raise DeviceError("the task does not swing")
        time.sleep(1e-3)


NOISE, CONTACT_NOISE, LAGS = (
    "noise of encoders and force",
    "noise of the force, contact detection armed",
    "servo lags by 0.2 s more",
)
UNDISTURBED = "the motion is completed, nothing latches"
MORE = 0.2  # [s] of lag
REST_TIME = 1.0  # [s] at rest with noise
FINISH_TIME = 0.4
"""[s] From a motion's last command until it counts as ended: the servo's tail, standstill for 0.1 s, and a little."""


def following_rows(rig: Rig) -> Iterator[Measurement]:
    """Yield the noise in mid-swing and at rest, and the lag in mid-swing: at rest there is nothing to lag."""
    yield Measurement(0, NOISE, Phase.SWING, rig.name, UNDISTURBED, partial(_swing_with_noise, rig, False))
    yield Measurement(0, NOISE, Phase.REST, rig.name, "stands still, does not latch", partial(_rest_with_noise, rig))
    yield Measurement(0, CONTACT_NOISE, Phase.SWING, rig.name, UNDISTURBED, partial(_swing_with_noise, rig, True))
    yield Measurement(7, LAGS, Phase.SWING, rig.name, "brakes on the path, latches", partial(_lags, rig))


def _make_noise(rig: Rig) -> None:
    """The noise of a controller of this generation, whatever the profile."""
    harsh = profile_of("harsh", rig.setting.controller.e_series)
    rig.controller.fault(
        "noise", position=harsh.encoders.position, velocity=harsh.encoders.velocity, force=harsh.force.noise[0],
        torque=harsh.force.noise[1], offset=harsh.force.offset[0],
    )  # fmt: skip


def _swing_with_noise(rig: Rig, armed: bool) -> FaultRow:
    rig.make_ready()
    _make_noise(rig)
    rig.arm.zero_wrench()
    rig.go_to_start()
    strike, guard = rig.strike, rig.contact_guard() if armed else None
    wrong: list[str] = []
    began = time.monotonic()
    try:
        got = str(rig.arm.execute(strike, guard, PATIENT).outcome)
    except TooleeError as error:
        got = type(error).__name__
        wrong.append(f"the motion was stopped: {error}")
    took = time.monotonic() - began
    if got != MotionOutcome.COMPLETED and not wrong:
        wrong.append(f"the motion ended as {got}")
    late = took - strike.duration - FINISH_TIME
    if late > 0.0:
        wrong.append(f"the end of the motion was noticed {late:.2f} s late")
    end = float(np.abs(np.array(rig.controller.state()["q"]) - strike.q[-1]).max())
    if end > AT_REST:
        wrong.append(f"the joints stand {end:.4f} rad beside the end of the path")
    return FaultRow(
        0, CONTACT_NOISE if armed else NOISE, Phase.SWING, rig.name, UNDISTURBED, got, bool(wrong), not wrong,
        "; ".join(wrong), off_path=end,
    )  # fmt: skip


def _rest_with_noise(rig: Rig) -> FaultRow:
    rig.prepare()
    before = rig.controller.state()["tick"]
    _make_noise(rig)
    time.sleep(REST_TIME)
    moved = travel(rig, before)
    wrong = [] if moved < AT_REST else [f"the arm moved by {moved:.4f} rad"]
    latched = False
    try:
        rig.nudge()
    except TooleeError as error:
        latched = True
        wrong.append(f"the next motion failed: {error}")
    return FaultRow(
        0, NOISE, Phase.REST, rig.name, "stands still, does not latch", "stands still", latched, not wrong,
        "; ".join(wrong), off_path=moved,
    )  # fmt: skip


def _lags(rig: Rig) -> FaultRow:
    setting = rig.setting
    usual = profile_of("harsh", setting.controller.e_series).servo
    assert usual is not None
    more = replace(usual, dead_time=usual.dead_time + MORE)
    happened = rig.inject(lambda: rig.controller.fault("lag", seconds=MORE))
    stop, strike, limits = happened.stop, rig.strike, rig.swing.config.arm
    latched = rig.is_latched()
    notice = setting.noticing(strike, stop.path_time, PATIENT.tracking_error, more) + 3 * rig.period
    # One more cycle: the fault itself takes effect in the controller's next one.
    allowed = notice + setting.braking(strike, stop.path_time, notice, limits, lag=more) + 3 * rig.period
    wrong = []
    if not isinstance(happened.error, TrackingError):
        wrong.append(f"TrackingError expected, got {happened.error!r}")
    if not latched:
        wrong.append("the next motion was not refused")
    if stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if stop.off_path > OFF_PATH + setting.rounding(strike, more):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    return FaultRow(
        7, LAGS, Phase.SWING, rig.name, "brakes on the path, latches", type(happened.error).__name__, latched,
        not wrong, "; ".join(wrong), stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip
