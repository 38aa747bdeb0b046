"""Planning of a strike, a swing of all joints: choice of the contact, the optimal motion through it, the checks."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control.arm_dynamics import TORQUE_SHARE, ArmDynamics
from toolee_robot.control.collision import BESIDE_NAILS, BRAKE_EXEMPT, FAR, RUN_UP_EXEMPT, Clearance, CollisionWorld
from toolee_robot.control.collision_shapes import TOOL_JOINT
from toolee_robot.control.contact import yield_length
from toolee_robot.control.correction import Candidates, candidates, rank
from toolee_robot.control.limits import check_trajectory
from toolee_robot.control.planning.straight import HIGHEST_TOUCH, Line
from toolee_robot.control.planning.swing_problem import (
    LATERAL,
    SLOPE,
    Face,
    SwingProblem,
    decelerations,
    fastest,
    sampled_within,
)
from toolee_robot.control.planning.swing_spline import spline_for
from toolee_robot.control.planning.transfer import NEED, STEP, plan_transfer
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError, LimitError, PlanningError, UnreachableError, UserError
from toolee_robot.frames import Array, is_rigid
from toolee_robot.station import StationConfig
from toolee_robot.types import Payload, Trajectory

MIN_SPEED = 0.3
"""Least useful speed of a strike [m/s]; a slower one does not drive the nail."""
MOMENTUM_SHARE = 0.95
"""Share of the permitted momentum that a strike is planned with: the controller computes its own, from what it was told
of the payload."""
SHORTLIST = 6
"""Number of contacts of one branch through which a swing may be planned."""
ENOUGH, MOST = 2, 5
"""Number of swings of which the fastest is taken; more, up to MOST, while none can be reached on a straight way."""
APPROACH_SHARE = 0.5
"""Share of a strike's velocities and accelerations on the way to its start, with nobody in reach."""
TRIES = 16
"""Number of contacts without a swing after which no further one is tried."""
CONE_ERROR, HEIGHT = 0.001, 0.02
"""By how much the face may be outside of its cone before the contact, between the knots of the spline, and up to
which height over the nail that is looked at [m]."""


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
    """Plan one strike: a swing, an optimal motion of all joints through the contact and back.

    At the contact the face's centre is on the nail's axis, its normal along it, and its velocity too. The command turns
    back within `strike.deepest` beyond the contact, or within what a mount yields, if that is less. The result depends
    on the arguments only.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: Collision model with the same `q_hand` and `X_hand_ee`.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        X_hand_ee: Estimated pose of the end effector in the hand, (4, 4).
        X_base_nail: Pose of the nail, (4, 4), z into the wood.
        tool: Mass of the tool [kg] and its centre of mass in the end effector's frame [m].
        speed: Wanted speed at the contact [m/s]; None for `station.strike.speed`, infinite for the fastest. It is
            reduced if a limit requires it.

    Returns:
        The plan; its `run_up` is the height of the face over the contact at the start, its `brake_length` the deepest
        place of the command beyond the contact.

    Raises:
        UnreachableError: No spin and branch reaches the nail.
        CollisionError: Every swing would collide; the message names the closest pair.
        LimitError: No swing satisfies the limits, or none is faster than MIN_SPEED.
        UserError: A pose is not a rigid transform.
    """
    began = time.perf_counter()
    if not (is_rigid(X_hand_ee) and is_rigid(X_base_nail)):
        raise UserError("X_hand_ee and X_base_nail must be finite rigid 4x4 transforms", code="user.not_rigid")
    # From within an obstacle no swing can begin, whatever its contact.
    world.check(q_start, 1e-6, "the start of the transfer")
    wanted = min(config.strike.speed if speed is None else speed, config.supervisor.unattended_speed)
    swing = _Swing(robot, config, world, q_hand, X_hand_ee, X_base_nail, tool, wanted)
    failure: PlanningError | None = None
    found: list[_Solved] = []
    blocked: set[int] = set()  # branches from which no way leads to a swing that was tried
    contacts = swing.contacts(q_start)
    more = True
    while more or found:
        more, failing = False, 0
        for branch, theta, q_contact in contacts:
            if branch in blocked:
                continue
            try:
                found.append(swing.solve(branch, theta, q_contact, q_start))
            except (UnreachableError, LimitError, CollisionError) as error:
                failure, failing = failure or error, failing + 1
                if failing == TRIES:
                    break
                continue
            best = max(found, key=_value)
            more = len(found) == MOST or ((len(found) >= ENOUGH or best.speed >= 0.99 * wanted) and best.direct)
            if more:
                break
        for solved in sorted(found, key=_value, reverse=True):
            if solved.branch in blocked:
                continue
            try:
                approach = plan_transfer(robot, config, world, q_start, solved.strike.q[0], share=APPROACH_SHARE)
            except (UnreachableError, LimitError, CollisionError) as error:
                failure = error  # a swing without a way to it says more than a contact without a swing
                blocked.add(solved.branch)
                continue
            return swing.plan(solved, approach, wanted, began)
        found = []
    assert failure is not None
    raise failure


@dataclass(frozen=True)
class _Solved:
    """A swing that satisfies every limit, before the way to its start is planned.

    Attributes:
        branch: Branch of the inverse kinematics.
        theta: Spin of the face [rad].
        strike: The motion.
        contact: Index of the sample at the contact.
        speed: Speed of the face at the contact [m/s].
        beyond: Distance of the face beyond the contact at the samples, (N,) [m].
        direct: Whether the straight way to its start is free: others take seconds to find.
    """

    branch: int
    theta: float
    strike: Trajectory
    contact: int
    speed: float
    beyond: Array
    direct: bool


def _value(solved: _Solved) -> float:
    return solved.speed * (1.0 if solved.direct else 0.8)


class _Swing:
    """What all contacts of one nail have in common."""

    def __init__(
        self,
        robot: RobotModel,
        config: StationConfig,
        world: CollisionWorld,
        q_hand: Array,
        X_hand_ee: Array,
        X_base_nail: Array,
        tool: Payload,
        wanted: float,
    ) -> None:
        self._robot, self._config, self._world, self._tool = robot, config, world, tool
        self._wanted, self._X_base_nail = wanted, X_base_nail
        self._X_flange_ee = robot.X_flange_hand(q_hand) @ X_hand_ee
        self._face = Face.build(robot.arm, self._X_flange_ee, X_base_nail)
        self._dynamics = ArmDynamics(robot, q_hand, X_hand_ee, tool)
        self._torque = TORQUE_SHARE * np.array(ARM_DATA[config.arm.model].torque)
        self._deepest = min(config.strike.deepest, yield_length(robot, q_hand, self._X_flange_ee))
        self._least = min(MIN_SPEED, 0.9 * wanted)
        self._momentum = MOMENTUM_SHARE * config.supervisor.momentum
        points = [body.spheres[:, :3] for body in world.bodies if body.joint == TOOL_JOINT]
        self._carried = np.concatenate([*points, robot.arm.X_joint6_flange[None, :3, 3]])
        self._spline = spline_for(config.arm)

    def contacts(self, q_start: Array) -> Iterator[tuple[int, float, Array]]:
        """Find the contacts through which a swing may be fast and free, best first.

        Args:
            q_start: Present joint positions, (6,) [rad].

        Yields:
            Branch of the inverse kinematics, spin of the face [rad] and joint positions, (6,) [rad], of each.

        Raises:
            UnreachableError: No spin and branch reaches the nail.
            LimitError: None of them can be struck faster than MIN_SPEED.
            CollisionError: All of them bring bodies together.
        """
        config = self._config
        found = candidates(self._robot.ik, self._X_base_nail, self._X_flange_ee, config.arm, q_start)
        score = self._score(found, q_start)
        chosen: dict[int, int] = {}
        nearest: Clearance | None = None
        for i in np.argsort(-score, kind="stable"):
            if score[i] <= 0:
                break
            branch = int(found.branch[i])
            if chosen.get(branch, 0) == SHORTLIST:
                continue
            clearance = self._world.closest(found.q[i], FAR, BRAKE_EXEMPT)
            nearest = nearest or clearance
            if clearance.distance >= config.strike.clearance:
                chosen[branch] = chosen.get(branch, 0) + 1
                yield branch, float(found.theta[i]), found.q[i]
        if nearest is None:
            raise LimitError(
                f"the arm cannot turn a tool of {self._tool.mass:.2f} kg back from {self._least:.2f} m/s within "
                f"{self._deepest * 1e3:.0f} mm at this nail: move the block nearer, or use a lighter hammer",
                code="limit.swing",
            )
        if not chosen:
            raise CollisionError(
                f"every swing at this nail would bring bodies together, the best one {nearest}: clear the way, move "
                "the block, or use a higher stand",
                code="collision.strike",
            )

    def _score(self, found: Candidates, near: Array) -> Array:
        """Kinematic rank plus the speed from which the arm can turn back in time, as a share of the wanted one."""
        top = self._wanted
        score = rank(found, top, near)
        most = np.asarray(self._config.arm.acceleration)
        slow = decelerations(self._face, self._dynamics, found.q, most, self._torque)
        possible = np.minimum(np.sqrt(2 * np.maximum(slow, 0.0) * self._deepest) / top, 1.0)
        return np.where(possible * top > self._least, score + 6.0 * possible, 0.0)

    def solve(self, branch: int, theta: float, q_contact: Array, q_start: Array) -> _Solved:
        """Find the swing through one contact, and check it.

        Args:
            branch: Branch of the inverse kinematics.
            theta: Spin of the face [rad].
            q_contact: Joint positions at the contact, (6,) [rad].
            q_start: Present joint positions, (6,) [rad].

        Returns:
            The swing.

        Raises:
            PlanningError: It is too slow, violates a limit, or collides.
        """
        config, world, arm = self._config, self._world, self._robot.arm
        problem = SwingProblem(
            face=self._face,
            dynamics=self._dynamics,
            spline=self._spline,
            q_contact=q_contact,
            carried=self._carried,
            wanted=self._wanted,
            velocity=np.asarray(config.arm.velocity),
            acceleration=np.asarray(config.arm.acceleration),
            jerk=config.arm.jerk,
            torque=self._torque,
            speed=config.supervisor.unattended_speed,
            momentum=self._momentum,
            deepest=self._deepest,
        )
        x = problem.solve()
        strike, contact = sampled_within(problem, world, x)
        J = self._face.place(q_contact[None])[1][0]
        speed = float(J[2] @ strike.qd[contact])
        if speed < self._least:
            raise LimitError(
                f"a swing at this nail reaches no more than {speed:.2f} m/s: move the block nearer to the middle of "
                "the arm's reach, or raise strike.deepest",
                code="limit.swing_speed",
            )
        place = self._face.place(strike.q)[0]
        beyond, beside = place[:, 2], np.max(np.abs(place[:, :2]), axis=1)
        deepest = float(np.max(beyond[contact:]))
        before = slice(0, contact)
        if np.max(beyond[before]) > 1e-5 or np.any(
            (beyond[before] > -HEIGHT) & (beside[before] > LATERAL + CONE_ERROR - SLOPE * beyond[before])
        ):
            raise LimitError("the swing does not come down on the nail along its axis", code="limit.swing")
        if deepest > self._deepest:
            raise LimitError(f"the swing turns back only {deepest * 1e3:.1f} mm beyond the contact", code="limit.swing")
        self._check_clear(strike, contact)
        # The nail is touched along this line with the same posture; a transfer leads to it.
        touched = Line.through(self._robot.ik, q_contact, self._X_base_nail[:3, 2])
        world.check(touched.q(np.array([max(beyond[0], -HIGHEST_TOUCH)])), NEED, "the way to a touch")
        check_trajectory(strike, arm, config.arm, config.scene, world)
        count = max(2, int(np.ceil(np.max(np.abs(strike.q[0] - q_start)) / STEP)) + 1)
        way = q_start + np.linspace(0.0, 1.0, count)[:, None] * (strike.q[0] - q_start)
        direct = world.free(way[:: max(1, count // 8)], NEED) and world.free(way, NEED)
        return _Solved(branch, theta, strike, contact, speed, beyond, direct)

    def _check_clear(self, strike: Trajectory, contact: int) -> None:
        """Raise CollisionError if bodies come too near."""
        need = self._config.strike.clearance
        self._world.check(strike.q[contact::-2], need, "the swing", RUN_UP_EXEMPT)
        self._world.check(strike.q[contact + 1 :: 2], need, "turning back after the strike", BRAKE_EXEMPT)
        self._world.check(strike.q[contact + 1 :: 2], 0.0, "turning back beside a nail", BRAKE_EXEMPT - BESIDE_NAILS)

    def plan(self, solved: _Solved, approach: Trajectory, wanted: float, began: float) -> StrikePlan:
        """Describe a swing.

        Args:
            solved: The swing.
            approach: The way to its start.
            wanted: Wanted speed [m/s].
            began: When the planning began, by `time.perf_counter` [s].

        Returns:
            The plan.
        """
        strike, contact, arm = solved.strike, solved.contact, self._robot.arm
        q_contact = strike.q[contact]
        J = self._face.place(q_contact[None])[1][0]
        nearest = (
            self._world.closest(strike.q[contact::-2], FAR, RUN_UP_EXEMPT),
            self._world.closest(strike.q[contact + 1 :: 2], FAR, BRAKE_EXEMPT),
        )
        return StrikePlan(
            theta=solved.theta,
            q_standoff=strike.q[0],
            q_contact=q_contact,
            approach=approach,
            strike=strike,
            contact_time=float(strike.times[contact]),
            speed=solved.speed,
            wanted_speed=wanted,
            attainable_speed=fastest(J, np.asarray(self._config.arm.velocity)),
            run_up=-float(solved.beyond[0]),
            brake_length=float(np.max(solved.beyond[contact:])),
            clearance=min(nearest, key=lambda c: c.distance),
            margin=float(np.min(np.minimum(strike.q - arm.lower, arm.upper - strike.q))),
            X_base_ee_contact=arm.fk(q_contact) @ self._X_flange_ee,
            planning_time=time.perf_counter() - began,
        )
