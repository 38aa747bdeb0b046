"""Collision-free, jerk-limited joint motions between configurations, with a stop at every via point."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.limits import check_carried, check_trajectory
from toolee_robot.control.planning.timing import concatenate, joint_move
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError, UserError
from toolee_robot.frames import Array
from toolee_robot.station import ArmLimits, StationConfig
from toolee_robot.types import Trajectory

STEP = 0.03
"""Joint step between the configurations checked along a motion [rad]."""
NEED = 0.012
"""Clearance on a transfer [m]: more than on a strike, since the samples are coarser."""


def plan_transfer(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    q_goal: Array,
    seed: int = 0,
    share: float = 0.0,
) -> Trajectory:
    """Plan a motion from rest to rest that keeps the clearance.

    The path is straight in joint space, or leads over the home posture or an intermediate one, or is found by
    RRT-Connect.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: The collision model.
        q_start: Initial joint positions, (6,) [rad].
        q_goal: Final joint positions, (6,) [rad].
        seed: Seed of the search.
        share: Largest velocity and acceleration as a share of a strike's, where that is more than those of transfers.

    Returns:
        The trajectory.

    Raises:
        CollisionError: No path was found; the message names the pair of bodies in the way.
        LimitError: The trajectory leaves the workspace or violates a limit.
        UserError: A configuration is not finite or has the wrong shape.
    """
    for name, q in (("start", q_start), ("goal", q_goal)):
        if q.shape != (6,) or not np.all(np.isfinite(q)):
            raise UserError(
                f"the {name} of a transfer must be six finite joint positions, got {q}",
                code="user.joint_positions",
            )
    world.check(q_goal, NEED, "the goal of the transfer")
    # A start with less clearance, such as the end of a strike, may be left, but the clearance may not shrink further.
    need = min(NEED, world.closest(q_start, NEED).distance)
    if need <= 0:
        world.check(q_start, 1e-6, "the start of the transfer")
    check_carried(np.stack([q_start, q_goal]), np.zeros(2), world)
    way = _Way(world, max(need - 1e-6, 0.0), q_start)
    path = _path(robot, config, way, q_start, q_goal, seed)
    limits = config.arm
    velocity, acceleration = transfer_limits(limits, share)
    jerk = np.minimum(limits.jerk, 10 * acceleration)
    moves = [joint_move(a, b, velocity, acceleration, jerk) for a, b in itertools.pairwise(path)]
    trajectory = concatenate(*moves)
    check_trajectory(trajectory, robot.arm, limits, config.scene, world)
    return trajectory


def transfer_limits(arm: ArmLimits, share: float = 0.0) -> tuple[Array, Array]:
    """Limits of the joints on a transfer.

    Args:
        arm: Configuration of the arm.
        share: A share of a strike's, where that is more.

    Returns:
        Velocities, (6,) [rad/s], and accelerations, (6,) [rad/s^2].
    """
    most = np.asarray(arm.acceleration)
    acceleration = np.maximum(np.minimum(arm.transfer_acceleration, most), share * most)
    return max(arm.transfer_velocity_scale, share) * np.asarray(arm.velocity), acceleration


@dataclass(frozen=True)
class _Way:
    """What a way must keep.

    Attributes:
        world: The collision model.
        need: Clearance [m].
        q_start: Where it starts, (6,) [rad].
    """

    world: CollisionWorld
    need: float
    q_start: Array

    def free(self, line: Array) -> bool:
        """Whether configurations, (N, 6) [rad], keep it."""
        return self.world.free(line, self.need) and self.world.inside(line, self.q_start)

    def direct(self, a: Array, b: Array) -> bool:
        """Whether the straight way between two configurations, (6,) [rad], keeps it."""
        line = _between(a, b)
        # A few samples first: most colliding motions are found by them.
        return self.free(line[:: max(1, len(line) // 8)]) and self.free(line)


def _path(robot: RobotModel, config: StationConfig, way: _Way, start: Array, goal: Array, seed: int) -> list[Array]:
    if way.direct(start, goal):
        return [start, goal]
    home = np.asarray(config.scene.home)
    middle = (start + goal) / 2
    vias = [home, np.concatenate([middle[:1], home[1:]]), np.concatenate([start[:1], home[1:]])]
    vias.append(np.concatenate([goal[:1], home[1:4], goal[4:]]))
    for via in vias:
        if way.direct(start, via) and way.direct(via, goal):
            return [start, via, goal]
    path = _rrt_connect(way, robot, start, goal, np.random.default_rng(seed))
    if path is None:
        line = _between(start, goal)
        closest = way.world.closest(line, max(way.need, 1e-6))
        if closest.distance >= way.need:
            raise CollisionError(
                "no path found for the transfer. On the straight path, hand or tool leave the workspace: enlarge the "
                "workspace, or move the target",
                code="collision.no_path",
            )
        raise CollisionError(
            f"no path found for the transfer. On the straight path, {closest} collide: clear the way, or move the "
            "target",
            code="collision.no_path",
        )
    return path


def _between(a: Array, b: Array, step: float = STEP) -> Array:
    """Interpolate configurations from a to b, both included, (N, 6) [rad]."""
    count = max(2, int(np.ceil(np.max(np.abs(b - a)) / step)) + 1)
    return a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)


def _rrt_connect(
    way: _Way,
    robot: RobotModel,
    start: Array,
    goal: Array,
    rng: np.random.Generator,
    iterations: int = 400,
    reach: float = 0.5,
) -> list[Array] | None:
    """RRT-Connect (Kuffner and LaValle, 2000), followed by shortcuts."""
    trees: list[tuple[list[Array], list[int]]] = [([start], [-1]), ([goal], [-1])]
    low = np.minimum(start, goal) - 1.0
    high = np.maximum(start, goal) + 1.0
    low, high = np.maximum(low, robot.arm.lower), np.minimum(high, robot.arm.upper)

    def extend(tree: tuple[list[Array], list[int]], target: Array) -> bool:
        """Extend the tree by one step towards the target; True when the target was reached."""
        nodes, parents = tree
        nearest = int(np.argmin(np.sum((np.stack(nodes) - target) ** 2, axis=1)))
        change = target - nodes[nearest]
        length = float(np.max(np.abs(change)))
        new = target if length <= reach else nodes[nearest] + change * (reach / length)
        if not way.free(_between(nodes[nearest], new)):
            return False
        nodes.append(new)
        parents.append(nearest)
        return length <= reach

    def branch(tree: tuple[list[Array], list[int]]) -> list[Array]:
        nodes, parents = tree
        found, i = [], len(nodes) - 1
        while i >= 0:
            found.append(nodes[i])
            i = parents[i]
        return found

    for _ in range(iterations):
        count = len(trees[0][0])
        extend(trees[0], rng.uniform(low, high))
        if len(trees[0][0]) > count:
            target = trees[0][0][-1]
            grown = -1
            while grown != len(trees[1][0]):
                grown = len(trees[1][0])
                if extend(trees[1], target):
                    path = branch(trees[0])[::-1] + branch(trees[1])[1:]
                    if not np.array_equal(path[0], start):
                        path.reverse()
                    return _shortcut(way, path)
        trees.reverse()
    return None


def _shortcut(way: _Way, path: list[Array]) -> list[Array]:
    """Remove every via point that is not needed."""
    out, i = [path[0]], 0
    while i < len(path) - 1:
        j = next(j for j in range(len(path) - 1, i, -1) if j == i + 1 or way.direct(path[i], path[j]))
        out.append(path[j])
        i = j
    return out
