"""Faulty commands that must never reach an arm: valid motions with one defect each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.arm import AT_REST
from tests.rigs.driver_rig import OFF_PATH, Happening, Rig
from tests.rigs.joints_path import PATIENT
from tests.rigs.people import People
from tests.rigs.strikes import Swing
from toolee_robot.control.limits import Mode
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.control.supervisor import Supervisor
from toolee_robot.errors import (
    CollisionError,
    DeviceError,
    LatchedError,
    LimitError,
    NotReadyError,
    PersonNearError,
    TooleeError,
    UnreachableError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionReport, MotionWatch
from toolee_robot.types import Trajectory

STEP = 0.004  # [s], sample period
BESIDE = 1e-3  # [rad], offset from the commanded position: about a millimetre at the tool


def good(swing: Swing, q: Array, change: Array) -> Trajectory:
    """Make a valid, slow motion, straight in joint space."""
    limits = swing.config.arm
    return joint_move(q, q + change, np.full(6, 0.4), np.full(6, 2.0), np.full(6, limits.jerk))


def not_finite(swing: Swing, q: Array, value: float) -> Trajectory:
    """Make a motion with NaN or infinity in its middle."""
    motion = good(swing, q, np.full(6, 0.02))
    broken = motion.q.copy()
    broken[len(broken) // 2, 3] = value
    return replace(motion, q=broken)


def beyond_joint_limit(swing: Swing, q: Array) -> Trajectory:
    """Make a motion of the last joint beyond its limit."""
    change = np.zeros(6)
    change[5] = 2 * np.pi + 0.2 - q[5]
    return good(swing, q, change)


def _integrated(q: Array, qdd: Array) -> Trajectory:
    """Integrate accelerations of joint 1, (N,) [rad/s^2], one per sample."""
    n = len(qdd)
    speed = np.concatenate([[0.0], np.cumsum(qdd[:-1]) * STEP])
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * STEP])
    times: Array = np.linspace(0.0, (n - 1) * STEP, n)
    first = np.eye(6)[0]
    return Trajectory(times, q + np.outer(way, first), np.outer(speed, first), np.outer(qdd, first))


def beside_the_arm(swing: Swing, q: Array) -> Trajectory:
    """Make a valid motion that starts off the commanded position."""
    return good(swing, q + BESIDE, np.full(6, 0.02))


def velocity_step(q: Array) -> Trajectory:
    """Make a motion with a velocity step of 0.5 rad/s."""
    qdd = np.zeros(60)
    motion = _integrated(q, qdd)
    way, speed = motion.q.copy(), motion.qd.copy()
    speed[10:, 0] = 0.5
    way[10:, 0] += 0.5 * STEP * np.arange(50)
    return replace(motion, q=way, qd=speed)


def acceleration_step(swing: Swing, q: Array) -> Trajectory:
    """Make a motion with twice the acceleration limit."""
    most = max(swing.config.arm.acceleration)
    return _integrated(q, np.concatenate([np.zeros(5), np.full(5, 2 * most), np.full(5, -2 * most), np.zeros(5)]))


def jerk_step(swing: Swing, q: Array) -> Trajectory:
    """Make a motion that alternates between the acceleration limits without exceeding them."""
    most = 0.8 * min(swing.config.arm.acceleration)
    return _integrated(q, np.concatenate([np.zeros(4), np.tile([most, most, -most, -most], 6), np.zeros(4)]))


def out_of_workspace(swing: Swing, q: Array) -> Trajectory:
    """Make a motion beyond the back of the workspace."""
    target = np.array([np.pi, -0.4, 0.0, q[3], q[4], q[5]])
    return good(swing, q, target - q)


def into_the_table(swing: Swing, q: Array) -> Trajectory:
    """Make a motion of the shoulder, backwards, that ends with the upper arm in the table."""
    change = np.zeros(6)
    change[1] = -1.9 * np.sign(q[2])
    return good(swing, q, change)


def into_itself(swing: Swing, q: Array) -> Trajectory:
    """Make a motion of wrist 2 that bends the hand into the forearm, within the workspace."""
    change = np.zeros(6)
    change[4] = 2.0 * np.sign(q[4])
    return good(swing, q, change)


def too_fast_for_a_handover(swing: Swing) -> Trajectory:
    """Return the strike, which is too fast for HANDOVER mode."""
    return swing.plan.strike


FAR = 10.0  # [m], distance of an unreachable nail
WATCH = 0.01  # [s], polling period of the person detection
COMES, BRAKES = "a person comes into reach", "brakes on the path, latches"


@dataclass(frozen=True)
class CommandFault:
    """A faulty command and the required reaction."""

    number: int
    fault: str
    error: type[TooleeError]
    send: Callable[[Supervisor, Rig, Array], object]
    latches: bool = False


def _execute(make: Callable[[Rig, Array], Trajectory]) -> Callable[[Supervisor, Rig, Array], object]:
    return lambda supervisor, rig, q: supervisor.execute(make(rig, q), None, PATIENT)


def _plan_far(_supervisor: Supervisor, rig: Rig, q: Array) -> object:
    swing = rig.swing
    X_base_nail = swing.config.work.X_base_nail()
    X_base_nail[0, 3] = FAR
    state = q, swing.q_hand, swing.X_hand_ee, X_base_nail
    return plan_strike(swing.robot, swing.config, swing.world, *state, tool=swing.tool)


COMMAND_FAULTS = (
    CommandFault(1, "NaN in a command", LimitError, _execute(lambda r, q: not_finite(r.swing, q, np.nan)), True),
    CommandFault(1, "infinity in a command", LimitError, _execute(lambda r, q: not_finite(r.swing, q, np.inf)), True),
    CommandFault(2, "beyond a joint's limit", LimitError, _execute(lambda r, q: beyond_joint_limit(r.swing, q))),
    CommandFault(3, "start beside the arm", LimitError, _execute(lambda r, q: beside_the_arm(r.swing, q))),
    CommandFault(3, "step in velocity", LimitError, _execute(lambda _, q: velocity_step(q))),
    CommandFault(3, "step in acceleration", LimitError, _execute(lambda r, q: acceleration_step(r.swing, q))),
    CommandFault(3, "step in jerk", LimitError, _execute(lambda r, q: jerk_step(r.swing, q))),
    CommandFault(4, "out of the workspace", LimitError, _execute(lambda r, q: out_of_workspace(r.swing, q))),
    CommandFault(5, "into the table", CollisionError, _execute(lambda r, q: into_the_table(r.swing, q))),
    CommandFault(5, "into itself", CollisionError, _execute(lambda r, q: into_itself(r.swing, q))),
    CommandFault(6, "nail out of reach", UnreachableError, _plan_far),
    CommandFault(27, "too fast for a handover", LimitError, _execute(lambda r, _q: too_fast_for_a_handover(r.swing))),
)


def command_rows(rig: Rig) -> Iterator[Measurement]:
    """Yield every faulty command, at rest and from another thread in mid-swing, then the faults of the person."""
    for fault in COMMAND_FAULTS:
        for phase, run in ((Phase.SWING, _in_swing), (Phase.REST, _at_rest)):
            if phase is Phase.SWING and fault.number == 27:
                continue  # the mode cannot be a handover's in mid-swing
            yield Measurement(fault.number, fault.fault, phase, rig.name, "rejected", partial(run, fault, rig))
    yield Measurement(27, COMES, Phase.SWING, rig.name, BRAKES, partial(_person_comes, rig))
    for inside, name in ((True, "a person is in reach"), (False, "nobody confirmed the swing")):
        yield Measurement(27, name, Phase.REST, rig.name, "no motion", partial(_no_motion, rig, inside, name))


def _supervised(rig: Rig) -> tuple[Supervisor, People]:
    """Make a supervisor that permits strikes, and its scripted person."""
    swing = rig.swing
    # Wide bounds, so that a busy machine adds no faults.
    bounds = replace(swing.config.supervisor, data_cycles=PATIENT.data_cycles, overruns=PATIENT.overruns)
    person = People()
    config = replace(swing.config, supervisor=bounds)
    supervisor = Supervisor(rig.arm, person, swing.robot, config, world=lambda: swing.world)
    supervisor.mode = Mode.UNATTENDED
    supervisor.permit_swings(1.0)
    return supervisor, person


def _swing(supervisor: Supervisor, rig: Rig) -> Callable[[Trajectory, ContactGuard | None, MotionWatch], MotionReport]:
    guard, contact = rig.contact_guard(), rig.swing.plan.expected_contact
    return lambda strike, _guard, _watch: supervisor.swing(strike, guard, contact)[0]


def _in_swing(fault: CommandFault, rig: Rig) -> FaultRow:
    supervisor, _ = _supervised(rig)

    def send() -> object:
        began = time.monotonic()
        try:
            return fault.send(supervisor, rig, rig.q_commanded)
        except TooleeError as error:
            return error, time.monotonic() - began

    happened = rig.inject(send, execute=_swing(supervisor, rig))
    error, took = happened.answer if isinstance(happened.answer, tuple) else (happened.answer, None)
    # A command during a motion may be refused for that reason alone.
    refused = isinstance(error, fault.error | NotReadyError)
    wrong = [] if refused else [f"{fault.error.__name__} expected, got {type(error).__name__}: {error}"]
    if fault.latches:
        if not supervisor.latched:
            wrong.append("it did not latch")
        wrong += _not_stopped(rig, happened, rig.period)
    elif happened.error is not None:
        wrong.append(f"the swing was disturbed: {happened.error}")
    elif happened.stop.reached < rig.strike.duration - 2 * rig.period:
        wrong.append("the swing did not reach its end")
    if happened.stop.off_path > OFF_PATH + rig.setting.rounding(rig.strike):
        wrong.append(f"the joints left the path by {happened.stop.off_path:.4f} rad")
    end, stop = "swing braked" if fault.latches else "swing undisturbed", happened.stop
    return FaultRow(
        fault.number, fault.fault, Phase.SWING, rig.name, _expected(fault, end), f"{type(error).__name__}, {end}",
        bool(supervisor.latched), not wrong, "; ".join(wrong), took, stop.standstill if fault.latches else None,
        _allowed(rig, happened, rig.period) if fault.latches else None, stop.speed, stop.off_path,
    )  # fmt: skip


def _at_rest(fault: CommandFault, rig: Rig) -> FaultRow:
    rig.prepare()
    supervisor, _ = _supervised(rig)
    if fault.number == 27:
        supervisor.mode = Mode.HANDOVER
    before = rig.controller.state()["tick"]
    began = time.monotonic()
    got: object = None
    try:
        got = fault.send(supervisor, rig, rig.q_commanded)
    except TooleeError as error:
        got = error
    took = time.monotonic() - began
    time.sleep(0.1)
    moved = float(np.ptp(rig.controller.trace(before).q_target, axis=0).max())
    wrong = [] if isinstance(got, fault.error) else [f"{fault.error.__name__} expected, got {type(got).__name__}"]
    if moved > AT_REST:
        wrong.append(f"the arm moved by {moved:.4f} rad")
    if bool(supervisor.latched) is not fault.latches:
        wrong.append("it did not latch" if fault.latches else "it latched")
    if fault.latches and not _refuses(supervisor, rig):
        wrong.append("the next motion was not refused")
    return FaultRow(
        fault.number, fault.fault, Phase.REST, rig.name, _expected(fault, "stands still"),
        f"{type(got).__name__}, stands still", bool(supervisor.latched), not wrong, "; ".join(wrong), took,
        off_path=moved,
    )  # fmt: skip


def _expected(fault: CommandFault, end: str) -> str:
    return f"rejected, {end}" + (", latches" if fault.latches else "")


def _refuses(supervisor: Supervisor, rig: Rig) -> bool:
    try:
        supervisor.execute(good(rig.swing, rig.q_commanded, np.full(6, 0.01)), None, PATIENT)
    except LatchedError:
        return True
    return False


def _allowed(rig: Rig, happened: Happening, notice: float) -> float:
    braking = rig.setting.braking(rig.strike, happened.stop.path_time, notice, rig.swing.config.arm)
    return notice + braking + 2 * rig.period


def _not_stopped(rig: Rig, happened: Happening, notice: float) -> list[str]:
    allowed = _allowed(rig, happened, notice)
    if happened.stop.standstill <= allowed:
        return []
    return [f"standstill after {happened.stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed"]


def _person_comes(rig: Rig) -> FaultRow:
    supervisor, person = _supervised(rig)
    happened = rig.inject(partial(setattr, person, "is_inside", True), execute=_swing(supervisor, rig))
    wrong = _not_stopped(rig, happened, WATCH + rig.period)
    if not isinstance(happened.error, PersonNearError):
        wrong.append(f"PersonNearError expected, got {happened.error!r}")
    if not supervisor.latched:
        wrong.append("it did not latch")
    if happened.stop.off_path > OFF_PATH + rig.setting.rounding(rig.strike):
        wrong.append(f"the joints left the path by {happened.stop.off_path:.4f} rad")
    stop = happened.stop
    return FaultRow(
        27, COMES, Phase.SWING, rig.name, BRAKES, type(happened.error).__name__, bool(supervisor.latched), not wrong,
        "; ".join(wrong), stop.reaction, stop.standstill, _allowed(rig, happened, WATCH + rig.period), stop.speed,
        stop.off_path,
    )  # fmt: skip


def _no_motion(rig: Rig, inside: bool, name: str) -> FaultRow:
    """Measure a swing with a person in reach if `inside`, else without a confirmation."""
    rig.prepare()
    supervisor, person = _supervised(rig)
    person.is_inside = inside
    if not inside:
        supervisor.mode = Mode.UNATTENDED  # which takes the permission away
    before = rig.controller.state()["tick"]
    got: object = None
    try:
        got = _swing(supervisor, rig)(rig.strike, None, PATIENT)
    except DeviceError as error:
        got = error
    time.sleep(0.1)
    moved = float(np.ptp(rig.controller.trace(before).q_target, axis=0).max())
    wrong = [] if isinstance(got, PersonNearError) else [f"PersonNearError expected, got {got!r}"]
    if moved > AT_REST:
        wrong.append(f"the arm moved by {moved:.4f} rad")
    return FaultRow(
        27, name, Phase.REST, rig.name, "no motion", f"{type(got).__name__}, stands still",
        bool(supervisor.latched), not wrong, "; ".join(wrong), off_path=moved,
    )  # fmt: skip
