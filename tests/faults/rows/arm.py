"""Faults of the robot, its network and its servo, under the real driver on the stand-in."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from tests.faults.record import FaultRow, Measurement, MissedMomentError, Phase
from tests.rigs.driver_rig import Happening, Rig, StopKind
from tests.rigs.joints_path import CLOSE, MOVING, PATIENT, SHORT_AGE, STRICT_AGE, STRICT_LOOP
from toolee_robot.errors import (
    DeviceError,
    EmergencyStopError,
    LatchedError,
    LinkLostError,
    MotionFaultError,
    NotReadyError,
    OverrunError,
    ProtectiveStopError,
    ServoCrashError,
    TrackingError,
)
from toolee_robot.hal import MotionOutcome, MotionWatch

AT_REST = 1e-4  # [rad]: what counts as standing still
WATCHDOG = 0.1  # [s] of silence after which the controller stops the program: `ServoConfig.watchdog`
HEARTBEAT = 0.1  # [s] `ServoConfig.heartbeat_timeout`
REST_TIME = 0.4  # [s] until a fault at rest must be detected
SLIDER, REFUSED = "speed slider at 50 %, then at 100 % again", "the next motion is refused, nothing latches"
SLIDER_TIME = 0.2  # [s] until the slider's place is known
QUIET_TIME = 2.2  # [s] likewise for a silent link: a little more than `ServoConfig.link_timeout`


@dataclass(frozen=True)
class ArmFault:
    """A fault of the arm and the required reaction."""

    number: int
    fault: str
    expected: str
    inject: Callable[[Rig], object]
    error: type[Exception] | None
    notice: Callable[[Rig], float]
    by_robot: StopKind | None = None
    slider: float = 1.0
    at_rest: bool | None = True
    watch: MotionWatch = PATIENT
    rest: float = REST_TIME


def _cycles(n: float) -> Callable[[Rig], float]:
    return lambda rig: n * rig.period


def _seconds(time: float) -> Callable[[Rig], float]:
    return lambda rig: time + rig.period


def _hold_up(rig: Rig, seconds: float) -> float:
    """Suspend the servo process for some seconds; by how much it became longer [s]."""
    pid, began = rig.arm.servo_pid, time.monotonic()
    os.kill(pid, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(pid, signal.SIGCONT)
    longer = time.monotonic() - began - seconds
    time.sleep(WATCHDOG)
    if rig.controller.state()["program_state"] != "PLAYING":
        raise MissedMomentError("the servo process was held up for so long that the robot's watchdog came first")
    return longer


def push_off(rig: Rig, angle: float) -> None:
    """Push the fastest joint of the swing off its path, against its motion, as an obstacle would."""
    qd = np.array(rig.controller.state()["qd_target"])
    speed = qd if np.abs(qd).max() > MOVING else np.eye(6)[1]
    offset = np.zeros(6)
    joint = int(np.abs(speed).argmax())
    offset[joint] = -np.copysign(angle, speed[joint])
    rig.controller.fault("joint_offset", offset=offset.tolist())


ARM_FAULTS = (
    ArmFault(
        0, "stop from another thread", "brakes on the path", lambda r: r.arm.stop(), None, _cycles(2), at_rest=None
    ),
    ArmFault(
        7, "joints are not where they were sent (0.08 rad)", "brakes on the path, latches",
        lambda r: push_off(r, 0.08), TrackingError, _cycles(3), watch=CLOSE,
    ),
    ArmFault(
        8, "data stops coming (stalled network)", "brakes on the path, latches",
        lambda r: r.controller.fault("stall", seconds=0.5, port="rtde"), LinkLostError, _seconds(WATCHDOG),
        by_robot="program", at_rest=None, watch=STRICT_AGE,
    ),
    ArmFault(
        8, "data comes, its timestamp stands still", "brakes on the path, latches",
        lambda r: r.controller.fault("freeze_timestamp"), LinkLostError, _cycles(5), watch=STRICT_AGE,
        rest=QUIET_TIME,
    ),
    ArmFault(
        9, "connection closed (FIN)", "robot's watchdog stops it, latches",
        lambda r: r.controller.fault("drop", port="rtde"), DeviceError, _seconds(WATCHDOG), by_robot="program",
    ),
    ArmFault(
        9, "connection reset (RST)", "robot's watchdog stops it, latches",
        lambda r: r.controller.fault("drop", port="rtde", reset=True), DeviceError, _seconds(WATCHDOG),
        by_robot="program",
    ),
    ArmFault(
        9, "half-open connection", "robot's watchdog stops it, latches",
        lambda r: r.controller.fault("half_open", port="rtde"), LinkLostError, _seconds(WATCHDOG), by_robot="program",
        rest=QUIET_TIME, watch=SHORT_AGE,
    ),
    ArmFault(
        9, "controller reboots", "robot's brakes fall in, latches",
        lambda r: r.controller.fault("reboot", seconds=1.0, powered=True), DeviceError, _cycles(2),
        by_robot="emergency",
    ),
    ArmFault(
        10, "servo loop late by 60 ms", "brakes on the path, latches",
        lambda r: _hold_up(r, 0.06), OverrunError, _seconds(0.06), at_rest=None, watch=STRICT_LOOP,
    ),
    ArmFault(
        11, "servo process killed", "robot's watchdog stops it, latches",
        lambda r: os.kill(r.arm.servo_pid, signal.SIGKILL), ServoCrashError, _seconds(WATCHDOG), by_robot="program",
    ),
    ArmFault(
        11, "servo process hangs", "robot's watchdog stops it, latches",
        lambda r: os.kill(r.arm.servo_pid, signal.SIGSTOP), ServoCrashError, _seconds(WATCHDOG), by_robot="program",
    ),
    ArmFault(
        12, "protective stop", "robot stops, latches until a person releases it",
        lambda r: r.controller.fault("protective_stop"), ProtectiveStopError, _cycles(2), by_robot="protective",
    ),
    ArmFault(
        13, "emergency stop", "robot stops, latches, nothing queued goes out",
        lambda r: r.controller.fault("emergency_stop"), EmergencyStopError, _cycles(2), by_robot="emergency",
    ),
    ArmFault(
        13, "safeguard stop", "robot stops, latches",
        lambda r: r.controller.fault("safeguard_stop"), EmergencyStopError, _cycles(2), by_robot="safeguard",
    ),
    ArmFault(
        13, "paused at the pendant", "robot stops, latches, its program is ended",
        lambda r: r.controller.fault("pause"), MotionFaultError, _seconds(0.25), by_robot="program",
    ),
    ArmFault(
        7, "speed slider moved to 50 %", "brakes on the path, latches",
        lambda r: r.controller.fault("speed_slider", fraction=0.5), MotionFaultError, _cycles(3), at_rest=None,
        slider=0.5,
    ),
    ArmFault(
        7, "controller slows the motion down to 50 %", "brakes on the path, latches",
        lambda r: r.controller.fault("speed_scaling", fraction=0.5), MotionFaultError, _cycles(3), at_rest=None,
        slider=0.5,
    ),
)  # fmt: skip


def arm_rows(rig: Rig, *, timed: bool = True) -> Iterator[Measurement]:
    """Yield every fault of the arm in mid-swing and, where applicable, at rest; when and where it stands if timed."""
    for fault in ARM_FAULTS:
        for phase, run in ((Phase.SWING, partial(_in_swing, timed)), (Phase.REST, _at_rest)):
            if phase is Phase.SWING or fault.at_rest is not None:
                yield Measurement(fault.number, fault.fault, phase, rig.name, fault.expected, partial(run, fault, rig))
    yield Measurement(7, SLIDER, Phase.REST, rig.name, REFUSED, partial(slider_at_rest, rig))


def _in_swing(timed: bool, fault: ArmFault, rig: Rig) -> FaultRow:
    happened = rig.inject(partial(fault.inject, rig), watch=fault.watch)
    if timed and isinstance(happened.answer, float) and happened.answer > rig.period:
        raise MissedMomentError(f"the servo process was held up for {happened.answer:.3f} s more than meant")
    stop, latched = happened.stop, rig.is_latched()
    allowed = fault.notice(rig) + _braking(fault, rig, happened) + 2 * rig.period
    wrong = _wrong(fault, happened, latched)
    if timed and stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if timed and stop.off_path > rig.off_path(stop.path_time, fault.by_robot, fault.notice(rig)):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    got = type(happened.error).__name__ if happened.error else str(happened.report and happened.report.outcome)
    return FaultRow(
        fault.number, fault.fault, Phase.SWING, rig.name, fault.expected, got, latched, not wrong, "; ".join(wrong),
        stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip


def _wrong(fault: ArmFault, happened: Happening, latched: bool) -> list[str]:
    wrong = []
    if fault.error is None:
        if happened.report is None or happened.report.outcome is not MotionOutcome.STOPPED:
            wrong.append(f"the motion was to report a stop, but: {happened.error or happened.report}")
        if latched:
            wrong.append("a stop is no fault and must not latch")
        return wrong
    if not isinstance(happened.error, fault.error) or not isinstance(happened.error, MotionFaultError):
        wrong.append(f"{fault.error.__name__} expected, got {type(happened.error).__name__}: {happened.error}")
    if not latched:
        wrong.append("the next motion was not refused")
    return wrong


def _braking(fault: ArmFault, rig: Rig, happened: Happening) -> float:
    """Shortest braking time from the position and speed at the fault [s]."""
    if fault.by_robot is not None:
        return happened.stop.speed / float(getattr(rig.setting.stops, fault.by_robot))
    limits, path_time = rig.swing.config.arm, happened.stop.path_time
    return rig.setting.braking(rig.strike, path_time, fault.notice(rig), limits, slider=fault.slider)


def _at_rest(fault: ArmFault, rig: Rig) -> FaultRow:
    rig.prepare()
    before = rig.controller.state()["tick"]
    fault.inject(rig)
    time.sleep(fault.rest)
    latched = rig.is_latched()
    moved = float(np.ptp(rig.controller.trace(before).q_target, axis=0).max())
    wrong = [] if moved < AT_REST else [f"the arm moved by {moved:.4f} rad"]
    if latched is not fault.at_rest:
        wrong.append("the next motion was not refused" if fault.at_rest else "it latched, though nothing was at fault")
    got = "stands still, latched" if latched else "stands still"
    return FaultRow(
        fault.number, fault.fault, Phase.REST, rig.name, "stands still, latches", got, latched, not wrong,
        "; ".join(wrong), off_path=moved,
    )  # fmt: skip


def slider_at_rest(rig: Rig) -> FaultRow:
    """Measure a slider that a person moves while the arm stands, and moves back."""
    rig.prepare()
    before = rig.controller.state()["tick"]
    rig.controller.fault("speed_slider", fraction=0.5)
    time.sleep(SLIDER_TIME)
    wrong, refusal, latched = [], None, False
    try:
        rig.nudge()
    except DeviceError as error:
        refusal = error
    if not isinstance(refusal, NotReadyError) or refusal.code != "not_ready.speed_slider":
        wrong.append(f"not_ready.speed_slider expected, got {refusal!r}")
    moved = float(np.ptp(rig.controller.trace(before).q_target, axis=0).max())
    if moved > AT_REST:
        wrong.append(f"the arm moved by {moved:.4f} rad")
    rig.controller.fault("speed_slider", fraction=1.0)
    time.sleep(SLIDER_TIME)
    try:
        rig.nudge()
    except DeviceError as error:
        latched = isinstance(error, LatchedError)
        wrong.append(f"it does not move with the slider at 100 %: {error!r}")
    return FaultRow(
        7, SLIDER, Phase.REST, rig.name, REFUSED, f"{getattr(refusal, 'code', refusal)}, stands still", latched,
        not wrong, "; ".join(wrong), off_path=moved,
    )  # fmt: skip
