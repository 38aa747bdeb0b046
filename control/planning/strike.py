"""Planning of a strike: choice of spin and branch, then one straight, timed and checked motion through the nail.

The run-up is a straight line along the nail's axis with the face perpendicular to it, timed by Ruckig over its length;
inverse kinematics is solved for every sample. The face arrives at the expected contact with full speed and zero
acceleration. Braking begins there, so that after a missed nail the block, not the table, stops the tool.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control.arm_dynamics import TORQUE_SHARE, ArmDynamics, torque_use
from toolee_robot.control.collision import BESIDE_NAILS, BRAKE_EXEMPT, FAR, RUN_UP_EXEMPT, Clearance, CollisionWorld
from toolee_robot.control.contact import yield_length
from toolee_robot.control.correction import Candidates, candidates, flange_targets, rank
from toolee_robot.control.limits import check_trajectory
from toolee_robot.control.planning.straight import Line, PathLimits, line_derivatives, strike_limits
from toolee_robot.control.planning.timing import brake_profile, ramp_length, run_up_profile
from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError, LimitError, PlanningError, UnreachableError, UserError
from toolee_robot.frames import Array, is_rigid
from toolee_robot.station import StationConfig
from toolee_robot.types import Payload, Trajectory

SHORTLIST = 24
"""Number of candidates whose whole line is solved and checked at once."""
TORQUE_ROUNDS = 6
"""Number of decelerations that are tried until a strike keeps the torques."""
MIN_SPEED = 0.3
"""Least useful speed of a strike [m/s]; a slower one does not drive the nail."""
ON_LINE, STAYS = 0.06, 0.1
"""Distance of the joints up to which the arm stands on a strike's line [rad], and what that adds to its score: another
posture takes half a second to reach, before every strike."""


def plan_strike(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    q_hand: Array,
    X_hand_ee: Array,
    X_base_nail: Array,
    *,
    tool: Payload,
    speed: float | None = None,
) -> StrikePlan:
    """Plan one strike.

    The arm brakes as hard as its joints' accelerations and, with this tool, TORQUE_SHARE of their torques allow.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: Collision model with the same `q_hand` and `X_hand_ee`.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        X_hand_ee: Estimated pose of the end effector in the hand, (4, 4); the nominal one for the uncorrected baseline.
        X_base_nail: Pose of the nail, (4, 4), z into the wood.
        tool: Mass of the tool [kg] and its centre of mass in the end effector's frame [m].
        speed: Wanted speed at the contact [m/s]; `station.strike.speed` if None. It is reduced where a limit requires
            it.

    Returns:
        The plan, with the speed that it attains.

    Raises:
        UnreachableError: No spin and branch reaches the nail with its run-up.
        CollisionError: Every strike would collide; the message names the closest pair.
        LimitError: No strike satisfies the limits, among them the joints' torques and the travel of a mount.
        UserError: A pose is not a rigid transform.
    """
    began = time.perf_counter()
    if not (is_rigid(X_hand_ee) and is_rigid(X_base_nail)):
        raise UserError("X_hand_ee and X_base_nail must be finite rigid 4x4 transforms", code="user.not_rigid")
    wanted = config.strike.speed if speed is None else speed
    X_flange_ee = robot.X_flange_hand(q_hand) @ X_hand_ee
    found = candidates(robot.ik, X_base_nail, X_flange_ee, config.arm, q_start)
    ranked = found.take(np.argsort(-rank(found, wanted, q_start)))
    fastest = min(wanted, float(np.max(ranked.attainable_speed[:SHORTLIST])))
    yields = yield_length(robot, q_hand, X_flange_ee)
    dynamics = ArmDynamics(robot, q_hand, X_hand_ee, tool)
    failure: PlanningError | None = None
    # An obstacle below the nail, a mount, or a heavy tool may leave too little room for braking: then a slower strike.
    for share in (1.0, 0.8, 0.6):
        top = share * fastest
        try:
            plan = _plan(robot, config, world, dynamics, q_start, ranked, X_base_nail, X_flange_ee, top, wanted, began)
        except (CollisionError, LimitError) as error:
            if isinstance(error, LimitError) and error.code != "limit.torque":
                raise
            failure = failure or error
            continue
        if plan.brake_length <= yields:
            return plan
        failure = failure or LimitError(
            f"the arm needs {plan.brake_length * 1e3:.0f} mm to stop behind the contact, but the "
            f"{robot.description.hand.label} yields only {yields * 1e3:.0f} mm at this tool's face: lower "
            "strike.speed, or take a mount with more travel",
            code="limit.yield_travel",
        )
    assert failure is not None
    raise failure


def _plan(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    dynamics: ArmDynamics,
    q_start: Array,
    ranked: Candidates,
    X_base_nail: Array,
    X_flange_ee: Array,
    speed: float,
    wanted: float,
    began: float,
) -> StrikePlan:
    """Plan the best strike of at most `speed` [m/s] among ranked candidates."""
    failure: PlanningError | None = None
    torque = TORQUE_SHARE * np.array(ARM_DATA[config.arm.model].torque)

    def blocked() -> bool:
        return failure is not None and failure.code == "collision.no_path"

    for found in _by_branches(robot, config, world, ranked, q_start, X_base_nail, X_flange_ee, speed, blocked):
        line, limits, index = found.line, found.limits, found.index
        assert found.clearance is not None
        try:
            strike, contact_time, brake = _time(line, limits, config.strike.run_up, dynamics, torque)
            contact = int(np.searchsorted(strike.times, contact_time - 1e-9))
            need = config.strike.clearance
            world.check(strike.q[: contact + 1 : 4], need, "the run-up", RUN_UP_EXEMPT)
            world.check(strike.q[contact + 1 :: 4], need, "braking after the strike", BRAKE_EXEMPT)
            check_trajectory(strike, robot.arm, config.arm, config.scene, world)
            approach = plan_transfer(robot, config, world, q_start, strike.q[0])
        except (UnreachableError, LimitError, CollisionError) as error:
            failure = failure or error
            continue
        return StrikePlan(
            theta=float(ranked.theta[index]),
            q_standoff=strike.q[0],
            q_contact=strike.q[contact],
            approach=approach,
            strike=strike,
            contact_time=contact_time,
            speed=limits.speed,
            wanted_speed=wanted,
            attainable_speed=float(ranked.attainable_speed[index]),
            run_up=config.strike.run_up,
            brake_length=brake,
            clearance=found.clearance,
            margin=found.margin,
            X_base_ee_contact=line.X_base_flange @ X_flange_ee,
            planning_time=time.perf_counter() - began,
        )
    assert failure is not None
    raise failure


@dataclass(frozen=True)
class _Feasible:
    """A candidate whose coarse line is reachable and fast enough.

    Attributes:
        value: Score, higher is better.
        index: Index in the shortlist.
        line: The line through the nail.
        limits: Limits of the motion along it.
        margin: Least distance to a joint's position limit [rad].
        clearance: Closest pair of bodies along the line; None until measured.
    """

    value: float
    index: int
    line: Line
    limits: PathLimits
    margin: float
    clearance: Clearance | None = None


def _by_branches(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    ranked: Candidates,
    near: Array,
    X_base_nail: Array,
    X_flange_ee: Array,
    wanted: float,
    blocked: Callable[[], bool],
) -> Iterator[_Feasible]:
    """Yield the best lines; while the way to them is `blocked`, those of other branches of the inverse kinematics, too.

    From where the arm stands there may be no way past itself to any line of one branch.
    """
    rows = np.arange(len(ranked.theta))
    while len(rows):
        short = ranked.take(rows[:SHORTLIST])
        try:
            best = _solve_lines(robot, config, world, short, near, X_base_nail, X_flange_ee, wanted)
        except PlanningError:
            if len(rows) == len(ranked.theta):
                raise
            return
        yield from (replace(found, index=int(rows[found.index])) for found in best)
        tried = [int(short.branch[found.index]) for found in best]
        if not blocked():
            return
        rows = rows[~np.isin(ranked.branch[rows], tried)]


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
    """Return the shortlist's lines that are reachable, fast enough and collision-free on a coarse grid, best first.

    The score is the kinematic rank, plus the ratio of attainable to wanted speed, plus 0.3 for a margin of 0.6 rad
    along the whole line, plus 0.4 for a clearance of FAR, plus STAYS for a line on which the arm already stands. Raises
    UnreachableError or CollisionError when none is left.
    """
    normal = X_base_nail[:3, 2]
    run_up = config.strike.run_up
    # About the braking length (1 rad/s^2 is some 0.45 m/s^2 here); the timed strike is checked again.
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
        if np.min(np.max(np.abs(q[i] - near), axis=-1)) < ON_LINE:
            value += STAYS
        line = Line(robot.ik, targets[i], normal, int(short.branch[i]), short.q[i])
        usable.append(_Feasible(value, int(i), line, limits, margin))
    if not usable:
        raise UnreachableError(
            f"the straight run-up of {run_up:.2f} m to the nail {failure} for every spin: move the block nearer to the "
            "middle of the arm's reach, or shorten config.strike.run_up",
            code="unreachable.run_up",
        )

    def order(candidate: _Feasible) -> tuple[bool, float]:
        # A strike at the wanted speed precedes every slower one, whatever its score.
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
            wide = clearance.distance
            if clearance.pair[1].startswith("nail "):  # passing beside a nail is as good as where there is none
                beside = world.closest(q[candidate.index][s <= 0], FAR, RUN_UP_EXEMPT | BESIDE_NAILS)
                wide = min(beside.distance, after.distance)
            clear.append(replace(candidate, value=candidate.value + 0.4 * wide / FAR, clearance=clearance))
        if len(clear) == 4:
            break
    if not clear:
        raise CollisionError(
            f"every strike at this nail would bring bodies together, the best one {nearest}: clear the way, move the "
            "block, or use a higher stand",
            code="collision.strike",
        )
    return sorted(clear, key=order)


def _time(
    line: Line, limits: PathLimits, run_up: float, dynamics: ArmDynamics, torque: Array
) -> tuple[Trajectory, float, float]:
    """Build the timed strike, which brakes within the torques; (it, time of contact [s], braking length [m]).

    Raises LimitError, with the code `limit.torque` where a slower strike may be possible.
    """
    up = run_up_profile(run_up, limits.speed, limits.acceleration, limits.jerk)
    contact_time, brake = float(up.times[-1]), limits.brake
    for _ in range(TORQUE_ROUNDS):
        down = brake_profile(limits.speed, brake, limits.jerk)
        whole = replace(
            up,
            times=np.concatenate([up.times, contact_time + down.times[1:]]),
            s=np.concatenate([up.s, down.s[1:]]),
            v=np.concatenate([up.v, down.v[1:]]),
            a=np.concatenate([up.a, down.a[1:]]),
        )
        strike = line.timed(whole)
        use = torque_use(dynamics, strike, torque)
        if np.max(use[: len(up.times)]) > 1.0:
            break
        if (most := float(np.max(use))) <= 1.0:
            return strike, contact_time, float(down.s[-1])
        # A part of the torque is that of the speed, which braking less hard does not change: hence the rounds.
        brake *= 0.98 / most
    raise LimitError(
        f"a strike at {limits.speed:.2f} m/s needs more than {TORQUE_SHARE:g} of a joint's torque: lower "
        "strike.speed, move the block nearer to the arm, or take a lighter hammer",
        code="limit.torque",
    )
