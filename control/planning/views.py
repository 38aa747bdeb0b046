"""Planning of hand poses: the handover, and the views in which the camera sees the tool.

A view places the EE 0.42 to 0.52 m in front of the camera, with its normal 30 to 50 deg off the line of sight and the
line of sight near the plane of handle and normal, so that the face of a tool rotated about its handle by 25 deg in the
hand is still visible. Head, handle and hand are in the image, unoccluded by hand and arm. Only the nominal tool is
used.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.kinematics import smallest_singular_value
from toolee_robot.control.planning.transfer import NEED, plan_transfer
from toolee_robot.control.records import View, ViewPlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError, LimitError, PlanningError, UnreachableError, UserError
from toolee_robot.frames import Array, frame_from_axes, inverse, transform, transform_points
from toolee_robot.station import CameraConfig, StationConfig
from toolee_robot.types import Trajectory

DISTANCE = (0.42, 0.52)  # [m] camera to EE
NORMAL_ANGLE = (np.deg2rad(30.0), np.deg2rad(50.0))  # between the EE's normal and the line of sight
AZIMUTH = np.deg2rad(30.0)  # of the line of sight, off the plane of handle and normal
SPREAD = (np.deg2rad(14.0), np.deg2rad(70.0))  # between the orientations of two views, as the camera sees them
IMAGE_MARGIN = 25.0  # [px]
ENOUGH = 40  # candidates among which distinct views are found
_SAMPLES = 1500
_HEAD_HALF = 0.10  # [m] from the EE along the handle: the middle of what must be seen


def plan_handover(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    q_hand: Array,
    *,
    tool_off: float = 0.0,
) -> Trajectory:
    """Plan a motion of the open palm to the handover position, facing the person.

    The rotation about the facing direction is free.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: Collision model with the empty hand.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        tool_off: How far the tool that comes may lie from where a tool is expected, in every direction [m].

    Returns:
        The trajectory, at rest at both ends.

    Raises:
        UnreachableError: The handover position is out of reach.
        CollisionError: Every posture or path would collide.
        LimitError: Hand or tool would leave the workspace.
    """
    scene = config.scene
    facing = np.asarray(scene.handover_facing) / np.linalg.norm(scene.handover_facing)
    # The palm faces -y of the hand. Fingers up first, then turned either way.
    turns = np.deg2rad(np.array([0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75, 90, -90]))
    X_up = frame_from_axes(z=np.array([0.0, 0, 1.0]) - facing[2] * facing, x=np.cross(-facing, [0.0, 0, 1.0]))
    Xs = np.stack([transform(Rotation.from_rotvec(t * facing).as_matrix() @ X_up[:3, :3]) for t in turns])
    Xs[:, :3, 3] = scene.handover_position
    q = robot.ik.branches(Xs @ inverse(robot.X_flange_hand(q_hand)))
    home = np.asarray(scene.home)
    turn, _ = np.nonzero(np.all(np.isfinite(q), axis=-1))
    q = robot.ik.unwrap(q[np.all(np.isfinite(q), axis=-1)], home)
    inside = np.all((q > robot.arm.lower) & (q < robot.arm.upper), axis=-1)
    q, turn = q[inside], turn[inside]
    if len(q) == 0:
        raise UnreachableError(
            f"the handover at {scene.handover_position} m in base_link is out of reach: change scene.handover_position",
            code="unreachable.handover",
        )
    # The posture must also be collision-free with a tool in the hand.
    X_tool_ee = frame_from_axes(z=np.array([1.0, 0, 0]), x=np.array([0, 0, -1.0]), p=[0.05, 0, 0.20])
    X_hand_ee = robot.description.hand.grasp.X_hand_tool(0.016) @ X_tool_ee
    with_tool = CollisionWorld(robot, config, q_hand, X_hand_ee, tool_off=tool_off)
    sigma = smallest_singular_value(robot.arm.fk_jacobian(q)[1])
    cost = np.max(np.abs(q - home), axis=-1) + 0.5 * np.abs(turns[turn]) - 2 * np.minimum(sigma, 0.15)
    failure: PlanningError | None = None
    for i in np.argsort(cost)[:40]:
        try:
            with_tool.check(q[i], NEED, "the handover, once the tool is in the hand,")
            return plan_transfer(robot, config, world, q_start, q[i])
        except (CollisionError, LimitError) as error:
            failure = failure or error
    raise failure or CollisionError("no handover posture is free of collisions")


def plan_views(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    q_hand: Array,
    X_hand_ee: Array,
    *,
    count: int = 5,
    seed: int = 0,
) -> ViewPlan:
    """Plan distinct views of the held tool and the transfers between them.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: Collision model with the same `q_hand` and `X_hand_ee`.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        X_hand_ee: Pose of the end effector in the hand, nominal or estimated, (4, 4).
        count: Number of views.
        seed: Seed of the sampled views.

    Returns:
        The views in the order of their visit.

    Raises:
        UnreachableError: No view is reachable and unoccluded.
        CollisionError: Fewer than `count` views are free of collisions.
        UserError: `count` is less than 1.
    """
    if count < 1:
        raise UserError("at least one view is needed")
    X_flange_ee = robot.X_flange_hand(q_hand) @ X_hand_ee
    Xs_base_ee, q = _sample(robot, config.camera, X_flange_ee, q_start, np.random.default_rng(seed))
    if len(q) == 0:
        near, far = DISTANCE
        raise UnreachableError(
            f"no view of the tool, {near:.2f} to {far:.2f} m before the camera, is within the arm's reach: in the "
            f"station file the camera {_where(config.camera)}. Correct that, or move the camera",
            code="unreachable.views",
        )
    head, handle = _sight(robot, world, config.camera, Xs_base_ee, q, inverse(X_hand_ee)[0, 3])
    # The hand may hide a short handle in every view: then only the head must be visible.
    seen = handle if np.count_nonzero(handle) >= ENOUGH else head
    Xs_base_ee, q = Xs_base_ee[seen], q[seen]
    if len(q) == 0:
        raise UnreachableError(
            "in every reachable view the hand hides the tool: in the station file the camera "
            f"{_where(config.camera)}. Correct that, or move the camera"
        )
    for chosen, clearance in _choices(robot, world, config.camera, Xs_base_ee, q, q_start, count):
        try:
            views, here = [], q_start
            for i in chosen:
                transfer = plan_transfer(robot, config, world, here, q[i])
                views.append(View(q[i], transfer, *_nominal(config.camera.center, Xs_base_ee[i])))
                here = q[i]
            return ViewPlan(tuple(views), clearance)
        except (CollisionError, LimitError):  # hand or tool would leave the workspace on the way
            continue
    raise CollisionError(
        f"fewer than {count} views of the tool are free of collisions and within the workspace: clear the space in "
        "front of the camera, or move the camera"
    )


def _where(camera: CameraConfig) -> str:
    """Where a camera stands and looks, in words."""
    X = camera.X_base_camera
    place, axis = (f"({', '.join(f'{0.0 + round(float(x), 2):g}' for x in v)})" for v in (X[:3, 3], X[:3, 2]))
    return f"stands at {place} m and looks along {axis}, both in base_link"


def _sample(
    robot: RobotModel, camera: CameraConfig, X_flange_ee: Array, near: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Sample reachable views; returns Xs_base_ee, (N, 4, 4), and joint positions, (N, 6) [rad]."""
    n = _SAMPLES
    X_base_camera = camera.X_base_camera
    centre, axis = X_base_camera[:3, 3], X_base_camera[:3, 2]
    angle = rng.uniform(*NORMAL_ANGLE, n)
    azimuth = rng.uniform(-AZIMUTH, AZIMUTH, n) + np.pi * rng.integers(0, 2, n)
    # Line of sight, from the EE to the camera, in the EE frame; the roll about it is free.
    line = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1)
    roll = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, n)[:, None] * np.array([0, 0, 1.0])).as_matrix()
    R_line_ee = np.swapaxes(_frames(line), -1, -2)
    distance = rng.uniform(*DISTANCE, n)
    Xs = np.tile(np.eye(4), (n, 1, 1))
    sight = np.tile(-axis, (n, 1))
    for _ in range(3):  # position and orientation of the EE depend on each other
        Xs[:, :3, :3] = _frames(sight) @ roll @ R_line_ee
        middle = centre + distance[:, None] * axis
        Xs[:, :3, 3] = middle - _HEAD_HALF * Xs[:, :3, 0]
        # At the wanted distance: pull the EE along its own ray.
        away = Xs[:, :3, 3] - centre
        Xs[:, :3, 3] = centre + away * (distance / np.linalg.norm(away, axis=-1))[:, None]
        sight = -away / np.linalg.norm(away, axis=-1)[:, None]
    inside = _in_image(camera, X_base_camera, Xs)
    Xs = Xs[inside]
    q = robot.ik.branches(Xs @ inverse(X_flange_ee))
    row, branch = np.nonzero(np.all(np.isfinite(q), axis=-1))
    q = robot.ik.unwrap(q[row, branch], near)
    sigma = smallest_singular_value(robot.arm.fk_jacobian(q)[1])
    good = np.all((q > robot.arm.lower + 0.1) & (q < robot.arm.upper - 0.1), axis=-1) & (sigma > 0.04)
    return Xs[row[good]], q[good]


def _frames(z: Array) -> Array:
    """Build rotations, (N, 3, 3), with the given z axes, (N, 3)."""
    side = np.where(np.abs(z[:, 2:]) < 0.9, [[0, 0, 1.0]], [[1.0, 0, 0]])
    x = np.cross(side, z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _in_image(camera: CameraConfig, X_base_camera: Array, Xs_base_ee: Array) -> NDArray[np.bool_]:
    """Whether the head and the handle up to the hand are in the image, (N,)."""
    points = np.array([[0, 0, 0.0], [-0.03, 0, 0], [0, 0, -0.13], [0.22, 0, -0.05]])
    p = transform_points(inverse(X_base_camera) @ Xs_base_ee, points)
    u = camera.fx * p[..., 0] / p[..., 2] + camera.cx
    v = camera.fy * p[..., 1] / p[..., 2] + camera.cy
    m = IMAGE_MARGIN
    return np.all((u > m) & (u < camera.width - m) & (v > m) & (v < camera.height - m) & (p[..., 2] > 0.2), axis=-1)


def _sight(
    robot: RobotModel, world: CollisionWorld, camera: CameraConfig, Xs_base_ee: Array, q: Array, hand_x: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether neither arm nor hand occludes the head, (N,), and the handle as well, (N,).

    `hand_x` is the palm's origin along the EE's x axis [m]; the handle is tested half-way between head and hand. Bodies
    are represented by their covering spheres, the line of sight by a cone from the camera to a disc around its target.
    """
    R, p = robot.arm.joints(q)
    eye = camera.X_base_camera[:3, 3]
    # Face, head, and a point of the handle in front of the hand, each with the radius that must be free.
    between = float(np.clip(0.5 * (hand_x - 0.05), 0.03, 0.08))
    targets = np.array([[0.0, 0, 0.0], [0, 0, -0.06], [between, 0, -0.05]])
    free = np.ones((3, len(q)), dtype=bool)
    for k, (target, radius) in enumerate(zip(targets, (0.03, 0.03, 0.015), strict=True)):
        ray = transform_points(Xs_base_ee, target[None])[:, 0] - eye
        length = np.linalg.norm(ray, axis=-1)
        ray = ray / length[:, None]
        for body in world.bodies:
            if body.group not in ("arm", "hand") or body.joint == 0:
                continue
            j = body.joint - 1
            c = np.einsum("nij,sj->nsi", R[:, j], body.spheres[:, :3]) + p[:, j, None] - eye
            along = np.einsum("nsi,ni->ns", c, ray)
            off = np.linalg.norm(c - along[..., None] * ray[:, None], axis=-1)
            need = body.spheres[:, 3] + radius * np.clip(along / length[:, None], 0, 1)
            before = (along > 0) & (along - body.spheres[:, 3] < length[:, None] - 0.01)
            free[k] &= ~np.any(before & (off < need), axis=-1)
    head = free[0] & free[1]
    return head, head & free[2]


def _choices(
    robot: RobotModel, world: CollisionWorld, camera: CameraConfig, Xs_base_ee: Array, q: Array, near: Array, count: int
) -> Iterator[tuple[list[int], float]]:
    """Yield sets of views, best first: distinct for the camera, near to each other for the arm, free of collisions."""
    center = camera.center
    angle = np.array([_nominal(center, X)[1] for X in Xs_base_ee])
    sigma = smallest_singular_value(robot.arm.fk_jacobian(q)[1])
    travel = np.max(np.abs(q - near), axis=-1)
    cost = travel / np.pi + np.abs(angle - np.deg2rad(40.0)) - 2 * np.minimum(sigma, 0.15)
    order = np.argsort(cost)
    normals = Rotation.from_matrix(Xs_base_ee[:, :3, :3])
    free: dict[int, float] = {}

    def clearance(i: int) -> float:
        if i not in free:
            free[i] = world.closest(q[i], 0.04).distance
        return free[i]

    starts = 0
    for first in order:
        if clearance(int(first)) < 1.5 * NEED:
            continue
        chosen = [int(first)]
        # Neighbours of the first, each as different as possible from those chosen.
        apart = (normals[int(first)].inv() * normals).magnitude()
        pool = (np.max(np.abs(q - q[first]), axis=-1) < 1.2) & (apart > SPREAD[0]) & (apart < SPREAD[1])
        least = apart
        while len(chosen) < count and np.any(pool):
            value = np.where(pool, np.minimum(least, np.deg2rad(25.0)) - 0.15 * cost, -np.inf)
            best = int(np.argmax(value))
            pool[best] = False
            if clearance(best) < 1.5 * NEED:
                continue
            chosen.append(best)
            least = np.minimum(least, (normals[best].inv() * normals).magnitude())
            pool &= least > SPREAD[0]
        if len(chosen) == count:
            yield _tour(q, chosen, near), min(map(clearance, chosen))
            starts += 1
            if starts == 8:
                return


def _tour(q: Array, chosen: list[int], start: Array) -> list[int]:
    """Order the chosen views by nearest neighbour."""
    left, tour, here = list(chosen), [], start
    while left:
        following = min(left, key=lambda i: float(np.max(np.abs(q[i] - here))))
        left.remove(following)
        tour.append(following)
        here = q[following]
    return tour


def _nominal(center: tuple[float, float, float], X_base_ee: Array) -> tuple[float, float]:
    """Compute the distance of the EE from the camera [m] and the angle of its normal to the line of sight [rad]."""
    sight = np.asarray(center) - X_base_ee[:3, 3]
    distance = float(np.linalg.norm(sight))
    return distance, float(np.arccos(np.clip(sight @ X_base_ee[:3, 2] / distance, -1, 1)))
