"""Plan turns of a tool about an axis of the work, such as a nut's, and where the arm can make them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control.collision import BRAKE_EXEMPT, CollisionWorld
from toolee_robot.control.kinematics import smallest_singular_value, solve
from toolee_robot.control.limits import check_trajectory
from toolee_robot.control.planning.timing import travel_profile
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import UnreachableError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.station import StationConfig
from toolee_robot.types import Trajectory

ACCELERATION, JERK = 0.8, 8.0
"""Of a turn [rad/s^2], [rad/s^3]."""
LEAST_SINGULAR_VALUE = 0.06
"""Of the arm's Jacobian, at every configuration of a place."""
CLEARANCE = 0.006
"""Least distance of any two bodies, except tool and work [m]."""


def about(axis: Array, point: Array, angles: Array) -> Array:
    """Rotations about an axis through a point.

    Args:
        axis: Unit vector, (3,), in `base`.
        point: A point of the axis, (3,) [m], in `base`.
        angles: Angles, (N,) [rad].

    Returns:
        The rotations, (N, 4, 4).
    """
    R = Rotation.from_rotvec(np.atleast_1d(angles)[:, None] * axis).as_matrix()
    X = np.tile(np.eye(4), (len(R), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = R, point - R @ point
    return X


def plan_turn(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    axis: Array,
    point: Array,
    angle: float,
    speed: float,
) -> Trajectory:
    """Plan a turn of the flange about an axis, from rest to rest.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: The collision model; the tool may touch the work.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        axis: Direction of the axis, a unit vector in `base`, (3,).
        point: A point on it, (3,) [m].
        angle: Angle [rad].
        speed: Largest speed [rad/s].

    Returns:
        The trajectory, checked for collisions and limits.

    Raises:
        CollisionError: Bodies would touch.
        LimitError: The trajectory violates a limit.
        UnreachableError: The turn is out of reach or singular.
    """
    profile = travel_profile(0.0, angle, speed, ACCELERATION, JERK)
    Xs = about(axis, point, profile.s) @ robot.arm.fk(q_start)
    q = robot.ik.branches_along(Xs[None], np.array([robot.ik.branch_of(q_start)]), q_start[None])[0]
    if not np.all(np.isfinite(q)) or np.any((q < robot.arm.lower) | (q > robot.arm.upper)):
        raise UnreachableError("the turn leaves the arm's reach", code="unreachable.turn")
    X_base_flange, J = robot.arm.fk_jacobian(q)
    linear = np.cross(axis, X_base_flange[:, :3, 3] - point)
    per_radian = np.concatenate([linear, np.broadcast_to(axis, linear.shape)], axis=1)
    qd = solve(J, per_radian) * profile.v[:, None]
    turn = Trajectory(profile.times, q, qd, np.gradient(qd, profile.times, axis=0))
    world.check(turn.q[:: max(1, len(turn.q) // 20)], 0.0, "the turn", BRAKE_EXEMPT)
    check_trajectory(turn, robot.arm, config.arm, config.scene, world)
    return turn


@dataclass(frozen=True, eq=False)
class Stroke:
    """The motions of one stroke, by the poses of the end effector.

    Attributes:
        X_base_ee: Pose at the work at the begin of the turn, (4, 4).
        way_on: Way of the tool onto the work, `base`, (3,) [m].
        axis: Axis of the turn, `base`, (3,).
        point: A point on it, (3,) [m].
        angle: Angle of the turn [rad].
        rise: Height over the work from which the tool comes [m].
    """

    X_base_ee: Array
    way_on: Array
    axis: Array
    point: Array
    angle: float
    rise: float

    def poses(self) -> Array:
        """Samples of the whole stroke, (N, 4, 4), each near the one before: from above, on, turned, off, and back."""
        before = transform(p=-self.way_on) @ self.X_base_ee
        high = transform(p=[0.0, 0.0, self.rise]) @ before
        turned = about(self.axis, self.point, np.linspace(0.0, self.angle, 9))
        steps = np.linspace(0.0, 1.0, 4)[:, None, None]
        down, on = high + steps * (before - high), before + steps * (self.X_base_ee - before)
        return np.concatenate([down, on, turned @ self.X_base_ee, (turned @ before)[::-1]])


def places(
    robot: RobotModel, world: CollisionWorld, q_near: Array, X_flange_ee: Array, strokes: list[Stroke]
) -> Iterator[tuple[int, Array]]:
    """Find where the arm can make a stroke, best first.

    Args:
        robot: Kinematic model of arm and hand.
        world: The collision model; the tool may touch the work.
        q_near: Present joint positions of the arm, (6,) [rad].
        X_flange_ee: Pose of the end effector in the flange, (4, 4).
        strokes: The strokes to choose from.

    Yields:
        Number of a stroke, and joint positions above the work, from where it begins, (6,) [rad].
    """
    found: list[tuple[float, int, Array]] = []
    for number, stroke in enumerate(strokes):
        Xs = stroke.poses() @ inverse(X_flange_ee)
        paths = robot.ik.branches_along(np.repeat(Xs[None], 8, 0), np.arange(8), np.repeat(q_near[None], 8, 0))
        for q in paths[np.isfinite(paths).all(axis=(1, 2))]:
            inside = np.all((q > robot.arm.lower + 0.05) & (q < robot.arm.upper - 0.05))
            if inside and smallest_singular_value(robot.arm.fk_jacobian(q)[1]).min() > LEAST_SINGULAR_VALUE:
                found.append((float(np.max(np.abs(q[0] - q_near))), number, q))
    for _, number, q in sorted(found, key=lambda item: item[0]):
        if world.free(q, CLEARANCE, BRAKE_EXEMPT):
            yield number, q[0]
