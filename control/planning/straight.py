"""Planning of straight motions: to the start of a guarded touch, and along any direction.

A motion that is straight in joint space does not keep the tool on a line. Here the inverse kinematics is solved for the
pose of every sample, and velocity and acceleration follow from the path's first and second derivatives.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from toolee_robot.control.collision import BRAKE_EXEMPT, CollisionWorld
from toolee_robot.control.inverse_kinematics import InverseKinematics
from toolee_robot.control.kinematics import ArmKinematics, solve
from toolee_robot.control.limits import check_trajectory
from toolee_robot.control.planning.timing import PathProfile, concatenate, travel_profile
from toolee_robot.control.planning.transfer import NEED, plan_transfer, transfer_limits
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError, UnreachableError
from toolee_robot.frames import Array
from toolee_robot.station import StationConfig
from toolee_robot.types import Trajectory

_STEP = 1e-4  # [m], for the second derivative


@dataclass(frozen=True)
class PathLimits:
    """Limits of the motion along a line that keep every joint within its own limits.

    Attributes:
        speed: Largest speed [m/s].
        acceleration: Largest acceleration [m/s^2].
        jerk: Largest jerk [m/s^3].
    """

    speed: float
    acceleration: float
    jerk: float


@dataclass(frozen=True)
class Line:
    """The flange poses X_base_flange shifted by s [m] along a direction.

    Attributes:
        ik: Inverse kinematics of the arm.
        X_base_flange: Pose of the flange at s = 0, (4, 4).
        direction: Direction of the line, a unit vector in `base`, (3,).
        branch: Branch of the inverse kinematics.
        q_zero: Joint positions at s = 0, (6,) [rad].
    """

    ik: InverseKinematics
    X_base_flange: Array
    direction: Array
    branch: int
    q_zero: Array

    @classmethod
    def through(cls, ik: InverseKinematics, q: Array, direction: Array) -> Line:
        """Build the line through a configuration, on its branch.

        Args:
            ik: Inverse kinematics of the arm.
            q: Joint positions at s = 0, (6,) [rad].
            direction: Direction in `base`, (3,), any length.

        Returns:
            The line; s = 0 is the configuration's flange pose, whose orientation it keeps.

        Raises:
            UnreachableError: The configuration is singular.
        """
        return cls(ik, ik.arm.fk(q), direction / np.linalg.norm(direction), ik.branch_of(q), q)

    def q(self, s: Array) -> Array:
        """Compute configurations on the line.

        Args:
            s: Positions along the line in any order, (M,) [m].

        Returns:
            Joint positions, (M, 6) [rad].

        Raises:
            UnreachableError: The line leaves the branch, passes a singularity, or exceeds a joint's position limit.
        """
        # The chain of whole turns starts at s = 0, where the configuration is known.
        order = np.argsort(s)
        s_sorted = np.concatenate([[0.0], s[order]])
        Xs = np.repeat(self.X_base_flange[None], len(s_sorted), axis=0)
        Xs[:, :3, 3] += s_sorted[:, None] * self.direction
        q = self.ik.branches_along(Xs[None], np.array([self.branch]), self.q_zero[None])[0]
        arm = self.ik.arm
        reached = np.isfinite(q).all(axis=1)
        if not reached.all():
            raise UnreachableError(
                f"the straight line is out of reach from s = {s_sorted[~reached][0]:.3f} m on", code="unreachable.line"
            )
        if np.any((q < arm.lower) | (q > arm.upper)):
            raise UnreachableError("the straight line leaves a joint's position limits", code="unreachable.joint_limit")
        out = np.empty((len(s), 6))
        out[order] = q[1:]
        return out

    def derivatives(self, q: Array) -> tuple[Array, Array]:
        """Compute dq/ds [rad/m] and d2q/ds2 [rad/m^2], (M, 6) each, at joint positions q, (M, 6) [rad]."""
        return line_derivatives(self.ik.arm, q, self.direction)

    def timed(self, profile: PathProfile) -> Trajectory:
        """Build the trajectory along the line with the timing of a profile."""
        q = self.q(profile.s)
        first, second = self.derivatives(q)
        qdd = first * profile.a[:, None] + second * (profile.v**2)[:, None]
        return Trajectory(profile.times, q, first * profile.v[:, None], qdd)

    def travel_limits(self, q: Array, velocity: Array, acceleration: float, jerk: float, wanted: float) -> PathLimits:
        """Compute the limits of a slow motion along the line, where |q' a + q'' v^2| counts as acceleration.

        Args:
            q: Configurations on the line, (M, 6) [rad].
            velocity: Velocity limits of the joints, (6,) [rad/s].
            acceleration: Acceleration limit of every joint [rad/s^2].
            jerk: Jerk limit of every joint [rad/s^3].
            wanted: Largest speed [m/s].

        Returns:
            Largest speed [m/s], acceleration [m/s^2] and jerk [m/s^3] along the line.
        """
        first, second = (np.maximum(np.abs(d), 1e-9) for d in self.derivatives(q))
        speed = min(wanted, float(np.min(velocity / first)), float(np.sqrt(np.min(0.5 * acceleration / second))))
        top = float(np.min((acceleration - second * speed**2) / first))
        return PathLimits(speed, top, 0.5 * jerk / float(np.max(first)))


def line_derivatives(arm: ArmKinematics, q: Array, direction: Array) -> tuple[Array, Array]:
    """Compute the derivatives of the joint positions with respect to the length of a straight motion.

    Args:
        arm: Kinematics of the arm.
        q: Joint positions, (M, 6) [rad].
        direction: Direction of the motion, a unit vector in `base`, (3,).

    Returns:
        dq/ds [rad/m] and d2q/ds2 [rad/m^2], (M, 6) each.
    """
    unit = np.concatenate([direction, np.zeros(3)])

    def slope(q: Array) -> Array:
        return solve(arm.fk_jacobian(q)[1], np.broadcast_to(unit, (len(q), 6)))

    first = slope(q)
    second = (slope(q + _STEP * first) - slope(q - _STEP * first)) / (2 * _STEP)
    return first, second


LOWERING_SPEED, HIGHEST_TOUCH = 0.5, 0.20
"""Largest speed [m/s] and length [m] of the straight way down to where a guarded touch begins."""
HIGHEST_RISE, RISE_STEP = 0.10, 0.005
"""How far a tool rises from among bodies at most, and in which steps it is tried [m]."""


def plan_over_nail(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    plan: StrikePlan,
    before: float,
    *,
    near: bool = False,
) -> Trajectory:
    """Plan a motion to rest on a strike's line, where a guarded touch begins.

    It comes down that line from high over the nail, unless the face is over the nail already and the way is free.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: The collision model.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        plan: The strike.
        before: Distance above the expected contact [m].
        near: Whether the face is over the nail already.

    Returns:
        The trajectory, checked for collisions and limits, at rest at both ends.

    Raises:
        PlanningError: As `plan_transfer` and `plan_straight`.
    """
    line, high = _line_of(robot, plan), min(plan.run_up, HIGHEST_TOUCH)
    if near:
        with suppress(CollisionError):
            return plan_transfer(robot, config, world, q_start, line.q(np.array([-before]))[0])
    lower = _travel(line, config, -high, -before, LOWERING_SPEED)
    approach = concatenate(plan_transfer(robot, config, world, q_start, lower.q[0]), lower)
    check_trajectory(approach, robot.arm, config.arm, config.scene, world)
    return approach


def rise_to_clear(robot: RobotModel, world: CollisionWorld, q_start: Array) -> float:
    """Find how far to rise straight up until a transfer may begin.

    Args:
        robot: Kinematic model of arm and hand.
        world: The collision model.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].

    Returns:
        The least height at which all bodies are as clear of each other as on a transfer [m]; that at which they are
        clearest where there is none within HIGHEST_RISE.

    Raises:
        UnreachableError: The arm is in a singularity.
    """
    line = Line.through(robot.ik, q_start, np.array([0.0, 0.0, 1.0]))
    best, most = 0.0, world.closest(q_start, NEED).distance
    for height in np.arange(RISE_STEP, HIGHEST_RISE, RISE_STEP):
        if most >= NEED:
            break
        try:
            distance = world.closest(line.q(np.array([height])), NEED).distance
        except UnreachableError:
            break
        if distance > most:
            best, most = float(height), distance
    return best


def plan_straight(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    length: float,
    direction: ArrayLike = (0.0, 0.0, 1.0),
    speed: float = 0.25,
    share: float = 0.0,
) -> Trajectory:
    """Plan a straight motion of the flange with constant orientation, from rest to rest.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: The collision model; the tool may touch block and stand.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        length: Length of the motion [m]; negative against the direction.
        direction: Direction in `base`; up by default.
        speed: Largest speed [m/s].
        share: Largest velocity and acceleration of the joints as a share of a strike's, where that is more than those
            of transfers.

    Returns:
        The trajectory, checked for collisions and limits, at rest at both ends.

    Raises:
        CollisionError: Bodies would touch.
        LimitError: The trajectory violates a limit.
        UnreachableError: The line is out of reach or singular.
    """
    line = Line.through(robot.ik, q_start, np.asarray(direction, dtype=np.float64))
    move = _travel(line, config, 0.0, length, speed, share)
    world.check(move.q[:: max(1, len(move.q) // 20)], 0.0, "the straight move", BRAKE_EXEMPT)
    check_trajectory(move, robot.arm, config.arm, config.scene, world)
    return move


def _travel(
    line: Line,
    config: StationConfig,
    start: float,
    end: float,
    speed: float = 0.25,
    share: float = 0.0,
) -> Trajectory:
    """Build a motion along the line from rest to rest, with the limits of transfers or a share of a strike's."""
    velocity, acceleration = transfer_limits(config.arm, share)
    q = line.q(np.linspace(start, end, 9))
    limits = line.travel_limits(q, velocity, float(np.min(acceleration)), config.arm.jerk, speed)
    return line.timed(travel_profile(start, end, limits.speed, limits.acceleration, limits.jerk))


def _line_of(robot: RobotModel, plan: StrikePlan) -> Line:
    X_base_flange = robot.arm.fk(plan.q_contact)
    return Line(
        robot.ik, X_base_flange, plan.X_base_ee_contact[:3, 2], robot.ik.branch_of(plan.q_contact), plan.q_contact
    )
