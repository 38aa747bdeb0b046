"""Planning a strike: choose spin and branch, then one straight, timed, checked motion through the nail.

The run-up is a straight line along the nail's axis with the face square to it, timed by Ruckig over its length, every
sample solved by inverse kinematics. The face arrives at the expected contact at full speed and with no acceleration;
there braking begins, so a missed nail ends in the block rather than in the table.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.collision import BRAKE_EXEMPT, FAR, RUN_UP_EXEMPT, Clearance, CollisionWorld
from toolee_robot.control.correction import Candidates, candidates, flange_targets, rank
from toolee_robot.control.limits import check_trajectory
from toolee_robot.control.planning.line import Line, PathLimits, line_derivatives, strike_limits
from toolee_robot.control.planning.timing import brake_profile, concatenate, ramp_length, run_up_profile, travel_profile
from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError, LimitError, PlanningError, UnreachableError, UserError
from toolee_robot.frames import Array, is_rigid
from toolee_robot.types import Trajectory

SHORTLIST = 24
"""Candidates whose whole line is solved and measured."""
MIN_SPEED = 0.3
"""[m/s]; a slower strike drives nothing."""


def plan_strike(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    q_hand: Array,
    X_hand_ee: Array,
    X_base_nail: Array,
    *,
    speed: float | None = None,
) -> StrikePlan:
    """Plan one strike from rest at q_start (6,).

    world: built with the same q_hand (n,) and X_hand_ee (4x4); X_hand_ee: the estimate (or the nominal pose for the
    uncorrected baseline). X_base_nail: 4x4, z into the wood. speed: wanted [m/s], config.strike.speed if None; it is
    lowered rather than any limit broken, and the plan says what it attained.
    Raises UnreachableError, CollisionError or LimitError; nothing moves.
    """
    began = time.perf_counter()
    if not (is_rigid(X_hand_ee) and is_rigid(X_base_nail)):
        raise UserError("X_hand_ee and X_base_nail must be finite rigid 4x4 transforms")
    wanted = config.strike.speed if speed is None else speed
    X_flange_ee = robot.X_flange_hand(q_hand) @ X_hand_ee
    found = candidates(robot.ik, X_base_nail, X_flange_ee, config.arm, q_start)
    order = np.argsort(-rank(found, wanted, q_start))[:SHORTLIST]
    short = found.take(order)
    fastest = min(wanted, float(np.max(short.attainable_speed)))
    failure: PlanningError | None = None
    # What lies under the nail may be too near to brake above it: then a slower strike.
    for share in (1.0, 0.8, 0.6):
        try:
            return _plan(robot, config, world, q_start, short, X_base_nail, X_flange_ee, share * fastest, wanted, began)
        except CollisionError as error:
            failure = failure or error
    assert failure is not None
    raise failure


def _plan(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    short: Candidates,
    X_base_nail: Array,
    X_flange_ee: Array,
    speed: float,
    wanted: float,
    began: float,
) -> StrikePlan:
    """The best strike of at most `speed` [m/s] among the shortlist."""
    failure: PlanningError | None = None
    for found in _solve_lines(robot, config, world, short, q_start, X_base_nail, X_flange_ee, speed):
        line, limits, index = found.line, found.limits, found.index
        assert found.clearance is not None
        try:
            strike, contact_time, brake = _time(line, limits, config.strike.run_up)
            contact = int(np.searchsorted(strike.times, contact_time - 1e-9))
            need = config.strike.clearance
            world.check(strike.q[: contact + 1 : 4], need, "the run-up", RUN_UP_EXEMPT)
            world.check(strike.q[contact + 1 :: 4], need, "braking after the strike", BRAKE_EXEMPT)
            check_trajectory(strike, robot.arm, config.arm, config.scene)
            approach = plan_transfer(robot, config, world, q_start, strike.q[0])
        except (UnreachableError, LimitError, CollisionError) as error:
            failure = failure or error
            continue
        return StrikePlan(
            theta=float(short.theta[index]),
            q_standoff=strike.q[0],
            q_contact=strike.q[contact],
            approach=approach,
            strike=strike,
            contact_time=contact_time,
            speed=limits.speed,
            wanted_speed=wanted,
            attainable_speed=float(short.attainable_speed[index]),
            run_up=config.strike.run_up,
            brake_length=brake,
            clearance=found.clearance,
            margin=found.margin,
            X_base_ee_contact=line.X_base_flange @ X_flange_ee,
            planning_time=time.perf_counter() - began,
        )
    assert failure is not None
    raise failure


def plan_over_nail(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, q_start: Array, plan: StrikePlan, before: float
) -> Trajectory:
    """To rest on the strike's line, `before` [m] above the expected contact: where a slow touch begins."""
    line = _line_of(robot, plan)
    lower = _travel(line, config, -plan.run_up, -before)
    approach = concatenate(plan_transfer(robot, config, world, q_start, plan.q_standoff), lower)
    check_trajectory(approach, robot.arm, config.arm, config.scene)
    return approach


def plan_straight(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    length: float,
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0),
    speed: float = 0.25,
) -> Trajectory:
    """Straight along `direction` (base axes, up by default) by `length` [m] from rest at q_start, orientation kept, at
    up to `speed` [m/s].

    The tool may be as near to the block as it is at the start. Raises CollisionError, LimitError, UnreachableError.
    """
    line = Line.through(robot.ik, q_start, np.asarray(direction, dtype=np.float64))
    move = _travel(line, config, 0.0, length, speed)
    world.check(move.q[:: max(1, len(move.q) // 20)], 0.0, "the straight move", BRAKE_EXEMPT)
    check_trajectory(move, robot.arm, config.arm, config.scene)
    return move


@dataclass(frozen=True)
class _Feasible:
    """A candidate whose coarse line is reachable and fast enough; `index` into the shortlist. clearance: of that line,
    once measured."""

    value: float
    index: int
    line: Line
    limits: PathLimits
    margin: float
    clearance: Clearance | None = None


def _solve_lines(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    short: Candidates,
    near: Array,
    X_base_nail: Array,
    X_flange_ee: Array,
    wanted: float,
) -> list[_Feasible]:
    """The shortlist's lines, best first: reachable, fast enough and clear of everything on a coarse grid.

    Value: the kinematic rank, plus the speed that the accelerations leave (over the wanted one), plus 0.3 for a margin
    of 0.6 rad along the whole line, plus 0.4 for a clearance of FAR. Raises UnreachableError or CollisionError when
    none is left.
    """
    normal = X_base_nail[:3, 2]
    run_up = config.strike.run_up
    # About as far down as braking takes (1 rad/s^2 is some 0.45 m/s^2 here); the timed strike is checked once more.
    deepest = float(ramp_length(wanted, 0.45 * config.arm.acceleration, 0.3 * config.arm.jerk))
    s = np.concatenate([np.linspace(-run_up, 0.0, 9), np.linspace(0.0, deepest, 6)[1:]])
    targets = flange_targets(X_base_nail, X_flange_ee, short.theta)
    Xs = np.repeat(targets[:, None], len(s), axis=1)
    Xs[:, :, :3, 3] += s[:, None] * normal
    q = robot.ik.branches_along(Xs, short.branch, short.q)
    arm = robot.arm
    velocity = np.asarray(config.arm.velocity)
    score = rank(short, wanted, near)
    usable, failure = [], "leaves the arm's reach"
    # NaN compares as outside.
    reachable = np.flatnonzero(np.all((q > arm.lower) & (q < arm.upper), axis=(1, 2)))
    first, second = line_derivatives(arm, q[reachable].reshape(-1, 6), normal)
    first, second = first.reshape(-1, len(s), 6), second.reshape(-1, len(s), 6)
    for row, i in enumerate(reachable):
        limits = strike_limits(s, first[row], second[row], velocity, config.arm.acceleration, config.arm.jerk, wanted)
        if limits.speed < MIN_SPEED:
            failure = f"reaches no more than {limits.speed:.2f} m/s"
            continue
        margin = float(np.min(np.minimum(q[i] - arm.lower, arm.upper - q[i])))
        value = float(score[i]) + limits.speed / wanted + 0.3 * min(margin / 0.6, 1.0)
        line = Line(robot.ik, targets[i], normal, int(short.branch[i]), short.q[i])
        usable.append(_Feasible(value, int(i), line, limits, margin))
    if not usable:
        raise UnreachableError(
            f"the straight run-up of {run_up:.2f} m to the nail {failure} for every spin: move the block nearer to the "
            "middle of the arm's reach, or shorten config.strike.run_up"
        )

    def order(candidate: _Feasible) -> tuple[bool, float]:
        # No comfort makes up for a strike that is slower than wanted while another is not.
        return candidate.limits.speed < 0.999 * wanted, -candidate.value

    usable.sort(key=order)
    clear: list[_Feasible] = []
    nearest: Clearance | None = None
    for candidate in usable:
        before = world.closest(q[candidate.index][s <= 0], FAR, RUN_UP_EXEMPT)
        after = world.closest(q[candidate.index][s > 0], FAR, BRAKE_EXEMPT)
        clearance = min(before, after, key=lambda c: c.distance)
        nearest = nearest or clearance
        if clearance.distance >= config.strike.clearance:
            clear.append(
                replace(candidate, value=candidate.value + 0.4 * clearance.distance / FAR, clearance=clearance)
            )
        if len(clear) == 4:
            break
    if not clear:
        raise CollisionError(
            f"every strike at this nail would bring bodies together, the best one {nearest}: clear the way, move the "
            "block, or use a higher stand"
        )
    return sorted(clear, key=order)


def _time(line: Line, limits: PathLimits, run_up: float) -> tuple[Trajectory, float, float]:
    """The timed strike, the time of contact [s] and the braking length [m]."""
    up = run_up_profile(run_up, limits.speed, limits.acceleration, limits.jerk)
    down = brake_profile(limits.speed, limits.brake, limits.jerk)
    whole = replace(
        up,
        times=np.concatenate([up.times, up.times[-1] + down.times[1:]]),
        s=np.concatenate([up.s, down.s[1:]]),
        v=np.concatenate([up.v, down.v[1:]]),
        a=np.concatenate([up.a, down.a[1:]]),
    )
    return line.timed(whole), float(up.times[-1]), float(down.s[-1])


def _travel(line: Line, config: StationConfig, start: float, end: float, speed: float = 0.25) -> Trajectory:
    """Along the line at transfer limits, from rest to rest."""
    q = line.q(np.linspace(start, end, 9))
    limits = line.travel_limits(
        q,
        config.arm.transfer_velocity_scale * np.asarray(config.arm.velocity),
        config.arm.transfer_acceleration,
        config.arm.jerk,
        speed,
    )
    return line.timed(travel_profile(start, end, limits.speed, limits.acceleration, limits.jerk))


def _line_of(robot: RobotModel, plan: StrikePlan) -> Line:
    X_base_flange = robot.arm.fk(plan.q_contact)
    return Line(
        robot.ik, X_base_flange, plan.X_base_ee_contact[:3, 2], robot.ik.branch_of(plan.q_contact), plan.q_contact
    )
