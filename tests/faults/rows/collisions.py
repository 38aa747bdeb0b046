"""Protective stops by each detection of the controller, brought about by a cause, and told by the controller's code.

The driver must latch with a `ProtectiveStopError` that names the code and has its kind, and end the robot's program, so
that release and Play move nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tests.faults.record import FaultRow, Measurement, MissedMomentError, Phase
from tests.faults.rows.arm import AT_REST, REST_TIME, push_off
from tests.faults.rows.released_stops import release_and_play, travel
from tests.rigs.driver_rig import FAST, SETTLE_TIME, Rig, rig
from tests.rigs.joints_path import PATIENT, Stop, stop_after
from tests.rigs.setting import Setting
from tests.rigs.strikes import plan_swing
from toolee_robot.errors import DeviceError, ProtectiveStopError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import SafetyLimits
from toolee_robot.sim_backend.ur_controller.robot.safety_system import SafetyMode
from toolee_robot.types import Payload

EXPECTED = "the robot stops, the driver latches and ends its program; nothing moves after release and Play"
DETECTION = 0.06  # [s]: three times the detection's own smoothing, after which 95 % of a step have come through
LOAD = Payload(1.5, np.array([0.0, 0.0, 0.08]))
NO_LOAD = replace(LOAD, mass=0.0)
BOTH = (Phase.SWING, Phase.REST)
SHOULDER, ELBOW = 1, 2
FULL = 2 * np.pi  # [rad]: the model's range of a joint in both directions
DEVIATION, COLLISION, TORQUE, JUMP, LIMIT = "position_deviation", "collision", "torque", "torque_jump", "safety_limit"


@dataclass(frozen=True)
class Collision:
    """A cause of a protective stop."""

    code: str
    fault: str
    inject: Callable[[Rig], object]
    kind: str = LIMIT
    payload: Payload = LOAD
    limits: Callable[[SafetyLimits, Array], SafetyLimits] | None = None
    ideal: bool = False
    phases: tuple[Phase, ...] = (Phase.SWING,)


def _push(wrench: list[float]) -> Callable[[Rig], object]:
    return lambda rig: rig.controller.fault("force", wrench=wrench, seconds=0.3)


_TWIST = _push([0.0, 0.0, 0.0, 0.0, 80.0, 0.0])


def _deviate(rig: Rig) -> None:
    push_off(rig, 1.5 * rig.setting.values.limits.following_error)


def _nothing(_: Rig) -> None:
    """The swing itself is the cause."""


def _joint_range(joint: int, room: float) -> Callable[[SafetyLimits, Array], SafetyLimits]:
    """A range of a joint that ends `room` [rad] beyond the start of the swing."""

    def limits(own: SafetyLimits, start: Array) -> SafetyLimits:
        ranges = np.ones(6)
        ranges[joint] = (abs(start[joint]) + room) / FULL
        return replace(own, joint_position=tuple(ranges.tolist()))

    return limits


# A payload that large in mid-swing is stopped for its momentum on a CB3, before the torques count.
COLLISIONS = (
    Collision("C159", "pushed off its path, no payload set", _deviate, DEVIATION, NO_LOAD, ideal=True, phases=BOTH),
    Collision("C153", "pushed off its path", _deviate, DEVIATION, ideal=True, phases=BOTH),
    Collision("C158", "80 Nm on the tool, no payload set", _TWIST, COLLISION, NO_LOAD, phases=BOTH),
    Collision("C157", "80 Nm on the tool", _TWIST, COLLISION, phases=BOTH),
    Collision("C191A7", "250 N on the flange", _push([-250.0, 0.0, 0.0, 0.0, 0.0, 0.0]), ideal=True, phases=BOTH),
    Collision(
        "C173", "payload jumps from 1.5 to 50 kg",
        lambda r: r.controller.fault("payload", mass=50.0, cog=[0.0, 0.0, 0.1]), TORQUE, phases=(Phase.REST,),
    ),
    Collision(
        "C174", "payload jumps from 1.5 to 14.5 kg",
        lambda r: r.controller.fault("payload", mass=14.5, cog=[0.0, 0.0, 0.1]), JUMP, phases=(Phase.REST,),
    ),
    Collision(
        "C157", "12 kg hang on the flange that the robot does not know",
        lambda r: r.controller.fault("payload_error", mass=12.0, cog=[0.3, 0.3, 0.1]), COLLISION, phases=BOTH,
    ),
)  # fmt: skip
"""On the profile's own limits."""
RESTRICTED = (
    Collision("C191A1", "joint range of the safety configuration left by a swing", _nothing, ideal=True,
              limits=_joint_range(ELBOW, 0.2)),
    Collision("C191A1", "joint pushed out of the safety configuration's range", lambda r: push_off(r, 0.06), ideal=True,
              limits=_joint_range(SHOULDER, 0.03), phases=(Phase.REST,)),
    Collision("C191A2", "joint speed over the safety configuration's", _nothing, ideal=True,
              limits=lambda own, _: replace(own, joint_speed=0.6)),
    Collision("C191A3", "TCP speed over the safety configuration's", _nothing, ideal=True,
              limits=lambda own, _: replace(own, tcp_speed=1.0)),
    Collision("C191A12", "momentum over the safety configuration's", _nothing,
              limits=lambda own, _: replace(own, momentum=8.0)),
    Collision("C191A6", "power over the safety configuration's", _push([0.0, 0.0, 100.0, 0.0, 0.0, 0.0]),
              limits=lambda own, _: replace(own, power=30.0)),
)  # fmt: skip
"""In a safety configuration that is more restricted than the swing needs."""
UNREACHABLE = {
    "C204A3": "ur_rtde's script repeats servoj in a thread of its own until it is told to stop, which it does with "
    "stopl, and the watchdog ends the program of a client that falls silent"
}
"""Codes that no row has, and why ur_rtde's own script, which the tests run on the stand-in, cannot bring them about."""


def collision_rows(rig: Rig) -> Iterator[Measurement]:
    """Yield each cause on the profile's own limits, in mid-swing and at rest."""
    for fault in COLLISIONS:
        if not fault.ideal and rig.setting.profile == "ideal":
            continue
        for phase in fault.phases:
            run = partial(collision_row, fault, phase, rig)
            yield Measurement(12, f"{fault.code}: {fault.fault}", phase, rig.name, EXPECTED, run)


def restricted_rows(setting: Setting) -> Iterator[Measurement]:
    """Yield each violation of a restricted safety configuration, with a stand-in of its own."""
    for fault in RESTRICTED:
        if not fault.ideal and setting.profile == "ideal":
            continue
        for phase in fault.phases:
            run = partial(restricted_row, fault, phase, setting)
            yield Measurement(12, f"{fault.code}: {fault.fault}", phase, setting.name, EXPECTED, run)


def collision_row(fault: Collision, phase: Phase, rig: Rig) -> FaultRow:
    """Measure one protective stop."""
    return _in_swing(fault, rig) if phase is Phase.SWING else _at_rest(fault, rig)


def restricted_row(fault: Collision, phase: Phase, setting: Setting) -> FaultRow:
    """Measure one protective stop on a stand-in of its own."""
    assert fault.limits is not None
    limits = fault.limits(setting.values.limits, plan_swing(setting.model).strike.q[0])
    with rig(setting, limits) as arm_rig:
        return collision_row(fault, phase, arm_rig)


def _in_swing(fault: Collision, rig: Rig) -> FaultRow:
    rig.make_ready()
    rig.arm.set_payload(fault.payload)
    if fault.inject is _nothing:
        stop, error = _swing_over_a_limit(rig)
        detection = 0.0
    else:
        happened = rig.inject(partial(fault.inject, rig))
        stop, error, detection = happened.stop, happened.error, DETECTION
    wrong, code, latched = _judge(fault, rig)
    if (said := _wrong_error(fault, code, error)) is not None:
        wrong.append(said)
    allowed = detection + stop.speed / rig.setting.stops.protective + 2 * rig.period
    if stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if stop.off_path > rig.off_path(stop.path_time, "protective", detection):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    got = f"{code}, {getattr(error, 'code', type(error).__name__)}"
    return FaultRow(
        12, f"{fault.code}: {fault.fault}", Phase.SWING, rig.name, EXPECTED, got, latched, not wrong, "; ".join(wrong),
        stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip


def _swing_over_a_limit(rig: Rig) -> tuple[Stop, Exception | None]:
    """Swing until the controller stops the arm by itself: the stop from then on, and the error of the motion."""
    rig.prepare()
    before = rig.controller.state()["tick"]
    error: Exception | None = None
    try:
        rig.arm.execute(rig.strike, None, PATIENT)
    except DeviceError as raised:
        error = raised
    time.sleep(SETTLE_TIME)
    trace = rig.controller.trace(before)
    stopped = np.flatnonzero(trace.safety == SafetyMode.PROTECTIVE_STOP)
    if not len(stopped):
        raise MissedMomentError(f"the controller has not stopped the swing: {error}")
    stop = stop_after(trace, rig.strike, float(trace.stamps[stopped[0]]) - 0.5 * rig.period)
    if stop.speed < FAST:
        raise MissedMomentError(f"the controller stopped the arm at {stop.speed:.2f} rad/s: no mid-swing")
    return stop, error


def _at_rest(fault: Collision, rig: Rig) -> FaultRow:
    rig.prepare()
    rig.arm.set_payload(fault.payload)
    before = rig.controller.state()["tick"]
    fault.inject(rig)
    time.sleep(REST_TIME)
    wrong, code, latched = _judge(fault, rig)
    moved = travel(rig, before)
    if moved > AT_REST:
        wrong.append(f"the arm moved by {moved:.4f} rad")
    return FaultRow(
        12, f"{fault.code}: {fault.fault}", Phase.REST, rig.name, EXPECTED, f"{code}, stands still", latched, not wrong,
        "; ".join(wrong), off_path=moved,
    )  # fmt: skip


def _judge(fault: Collision, rig: Rig) -> tuple[list[str], str, bool]:
    """What is wrong after the stop, the controller's code, and whether the arm is latched."""
    load = fault.payload
    code = str(rig.controller.state()["safety_reason"]).partition(":")[0]
    wrong = [] if code.startswith(fault.code) else [f"{fault.code} expected, the controller says {code or 'nothing'}"]

    def release(controller: ControllerProcess) -> None:
        controller.fault("payload", mass=load.mass, cog=load.center_of_mass.tolist())  # as a person who has found it
        controller.fault("unlock")

    after, _, latched = release_and_play(rig, release)
    return wrong + after, code, latched


def _wrong_error(fault: Collision, code: str, error: Exception | None) -> str | None:
    """What is wrong with the error of the motion, if anything."""
    if not isinstance(error, ProtectiveStopError):
        return f"ProtectiveStopError expected, got {error!r}"
    if error.code != (expected := f"protective_stop.{fault.kind}"):
        return f"the error's code is {error.code}, {expected} expected"
    return None if code in str(error) else f"the error does not name {code}: {error}"
