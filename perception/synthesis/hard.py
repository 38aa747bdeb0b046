"""Hard scenes: random orientations, surroundings, hands and occluders; also scenes without tools."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import (
    Array,
    frame_from_axes,
    inverse,
    random_rotation,
    rotation_z,
    transform,
    transform_points,
)
from toolee_robot.perception.dataset.records import FARTHEST, NEAREST
from toolee_robot.perception.synthesis.bodies import (
    HandStyle,
    X_base_hand_of,
    X_hand_tool_of,
    arm_bodies,
    hand_bodies,
    tool_bodies,
)
from toolee_robot.perception.synthesis.clutter import any_object, backdrop, walls
from toolee_robot.perception.synthesis.placement import (
    PlacedTool,
    Pool,
    SceneSample,
    X_world_hand_of,
    look,
    lying,
    on_plane,
    random_intrinsics,
    random_pixel,
    tool_in_view,
)
from toolee_robot.perception.synthesis.surfaces import Surfaces
from toolee_robot.render import Body, Scene
from toolee_robot.render.lab import environment, lamps
from toolee_robot.render.mesh import box, cylinder
from toolee_robot.tools import ToolShape
from toolee_robot.types import CameraIntrinsics

ROOM, HAND, ARM, OBJECT = 100, 101, 102, 103
"""Body ids of everything except tools."""
_R_ROD = Rotation.from_euler("x", np.pi / 2).as_matrix()
"""Rotation from z to y, for rods that are modelled along z."""


def hard_scene(rng: np.random.Generator, pool: Pool, with_tools: bool = True) -> SceneSample:
    """Generate a hard scene: up to three tools in clutter, the first one mostly in a hand.

    Args:
        rng: Random generator.
        pool: Tools, grasps and surfaces.
        with_tools: Whether to include tools; without them, the scene still contains hands.

    Returns:
        The scene, with the camera.
    """
    intrinsics = random_intrinsics(rng)
    # The camera is at the origin of a world with z up; the table is placed so that it does not intersect held tools.
    pitch = np.deg2rad(rng.uniform(-85.0, 30.0))
    roll = rng.normal(0.0, 0.15) if rng.random() < 0.5 else rng.uniform(-np.pi, np.pi)
    X_world_camera = look(np.zeros(3), np.array([np.cos(pitch), 0.0, np.sin(pitch)]), roll)
    bodies: list[Body] = []
    placed: list[PlacedTool] = []
    count = int(rng.choice([1, 2, 3], p=[0.5, 0.3, 0.2])) if with_tools else 0
    lowest = np.inf
    for k in range(count):
        tool = pool.tool(rng)
        X_world_tool = X_world_camera @ tool_in_view(tool, intrinsics, rng)
        if any(np.linalg.norm(X_world_tool[:3, 3] - other.X_world_tool[:3, 3]) < 0.12 for other in placed):
            continue
        if rng.random() < (0.8 if k == 0 else 0.3):
            item, hand, lowest_hand = _held(rng, pool, tool, X_world_tool, len(placed) + 1)
            bodies += hand
            lowest = min(lowest, lowest_hand)
            placed.append(item)
        elif k == 0 or rng.random() < 0.4:
            placed.append(PlacedTool(tool, X_world_tool, None, False, len(placed) + 1))
        else:
            placed.append(PlacedTool(tool, np.full((4, 4), np.nan), None, False, len(placed) + 1))  # on the table
    if not with_tools and rng.random() < 0.6:
        grasp = pool.any_grasp(rng)
        X = X_world_camera @ transform(
            random_rotation(rng), intrinsics.rays(random_pixel(rng)) * rng.uniform(NEAREST, FARTHEST)
        )
        bodies += hand_bodies(grasp, HandStyle.random(rng), X, HAND)
    for item in placed:
        if np.all(np.isfinite(item.X_world_tool)):
            points = transform_points(item.X_world_tool, np.asarray(item.tool.mesh.vertices))
            lowest = min(lowest, float(points[:, 2].min()))
    table = _table_height(rng, lowest)
    if table is not None:
        bodies.append(_table(rng, pool.surfaces, X_world_camera, table))
    placed = [_settled(item, rng, intrinsics, X_world_camera, table) for item in placed]
    for item in placed:
        bodies += tool_bodies(item.tool, item.X_world_tool, item.body_id, rng)
    bodies += _objects(rng, pool.surfaces, intrinsics, X_world_camera, table)
    bodies += _occluders(rng, pool.surfaces, X_world_camera, placed)
    background = None
    if rng.random() < 0.85:
        floor = (min(lowest, 0.0) if table is None else table) - float(rng.uniform(0.3, 1.2))
        bodies += walls(rng, pool.surfaces, ROOM, floor)
    else:
        background = backdrop(rng, pool.surfaces)
    scene = Scene(bodies, lamps(rng), environment(rng), background)
    return SceneSample(scene, intrinsics, X_world_camera, tuple(placed), 0 if with_tools else 2)


def _held(
    rng: np.random.Generator, pool: Pool, tool: ToolShape, X_world_tool: Array, body_id: int
) -> tuple[PlacedTool, list[Body], float]:
    """A hand around the handle, rarely with the arm, and the lowest height of both [m]."""
    grasp = pool.grasp(tool, rng)
    style = HandStyle.random(rng)
    along = transform(p=(0.0, 0.0, rng.uniform(-0.03, 0.04)))
    X_world_hand = X_world_hand_of(X_world_tool @ along, X_hand_tool_of(grasp, style.mirrored))
    bodies = hand_bodies(grasp, style, X_world_hand, HAND, forearm=rng.random() < 0.85)
    lowest = min(float(transform_points(b.X_world_body, b.mesh.vertices.astype(float))[:, 2].min()) for b in bodies)
    if not style.mirrored and rng.random() < 0.3:
        q = rng.uniform([-3.0, -2.5, -2.4, -3.0, -3.0, -3.0], [3.0, -0.5, 2.4, 3.0, 3.0, 3.0])
        X_base_hand = X_base_hand_of(q, grasp.q_hand)
        bodies += arm_bodies(q, X_world_hand @ inverse(X_base_hand), ARM, rng)
    return PlacedTool(tool, X_world_tool, X_world_hand, style.mirrored, body_id), bodies, lowest


def _table_height(rng: np.random.Generator, lowest: float) -> float | None:
    """Random height [m] of a table below all held bodies and the camera, or None."""
    if rng.random() < 0.3:
        return None
    drop = rng.uniform(0.0, 0.1) if rng.random() < 0.4 else rng.uniform(0.1, 0.6)
    return float(min(lowest if np.isfinite(lowest) else -0.3, -0.2) - drop)


def _table(rng: np.random.Generator, surfaces: Surfaces, X_world_camera: Array, height: float) -> Body:
    """A table top (or the ground) below the view of the camera."""
    size = rng.uniform(0.6, 2.5, 2)
    ahead = X_world_camera[:3, 2] * rng.uniform(0.3, 1.0)
    X = transform(rotation_z(rng.uniform(0, np.pi)), (ahead[0], ahead[1], height - 0.02))
    return Body(box((float(size[0]), float(size[1]), 0.04)), X, surfaces.material(rng, 0.1), ROOM)


def _settled(
    item: PlacedTool,
    rng: np.random.Generator,
    intrinsics: CameraIntrinsics,
    X_world_camera: Array,
    table: float | None,
) -> PlacedTool:
    """Place a tool without a pose on the table, or in the air if the camera does not see the table."""
    if np.all(np.isfinite(item.X_world_tool)):
        return item
    point = None if table is None else on_plane(intrinsics, X_world_camera, table, random_pixel(rng), NEAREST, FARTHEST)
    X = X_world_camera @ tool_in_view(item.tool, intrinsics, rng) if point is None else lying(item.tool, point, rng)
    return PlacedTool(item.tool, X, None, False, item.body_id)


def _objects(
    rng: np.random.Generator,
    surfaces: Surfaces,
    intrinsics: CameraIntrinsics,
    X_world_camera: Array,
    table: float | None,
) -> list[Body]:
    """Random objects on the table and in the air."""
    bodies: list[Body] = []
    for _ in range(rng.poisson(12.0 if rng.random() < 0.35 else 3.5)):
        size = float(np.exp(rng.uniform(np.log(0.03), np.log(0.35))))
        pixel = random_pixel(rng, -0.1)
        point = None if table is None else on_plane(intrinsics, X_world_camera, table, pixel)
        if point is not None and rng.random() < 0.85:
            R = rotation_z(rng.uniform(0, 2 * np.pi)) if rng.random() < 0.6 else random_rotation(rng)
            X = transform(R, np.add(point, [0.0, 0.0, 0.3 * size]))
        else:
            p = X_world_camera[:3, :3] @ intrinsics.rays(pixel) * rng.uniform(0.7, 2.2)
            X = transform(random_rotation(rng), p)
        bodies += any_object(rng, surfaces, X, OBJECT, size)
    return bodies


def _occluders(
    rng: np.random.Generator, surfaces: Surfaces, X_world_camera: Array, placed: list[PlacedTool]
) -> list[Body]:
    """Occluders in front of most EEs of most scenes; each hides 0 to about 70 % of an EE."""
    bodies: list[Body] = []
    if rng.random() < 0.15:
        return bodies
    for item, ee in [(tool, ee) for tool in placed for ee in tool.tool.ees]:
        if rng.random() < 0.4:
            continue
        sight = (item.X_world_tool @ ee.X_tool_ee)[:3, 3] - X_world_camera[:3, 3]
        share = rng.uniform(0.45, 0.93)
        reach = share * ee.category.spec.radius  # of the EE, projected to the distance of the occluder
        R = frame_from_axes(z=sight, x=np.cross(sight, rng.normal(size=3)), p=np.zeros(3))[:3, :3]
        if rng.random() < 0.3:
            p = R[:, 0] * rng.uniform(0.2, 1.3) * reach
            X = transform(random_rotation(rng), X_world_camera[:3, 3] + share * sight + p)
            bodies += any_object(rng, surfaces, X, OBJECT, float(reach * rng.uniform(1.0, 3.0)))
            continue
        # A board or a rod with one edge in front of the EE.
        board = rng.random() < 0.6
        half = reach * (rng.uniform(0.8, 3.0) if board else rng.uniform(0.15, 0.7))
        size = (2.0 * half, reach * rng.uniform(2.0, 6.0), 0.01) if board else (half, reach * rng.uniform(3.0, 8.0))
        p = R[:, 0] * (half + rng.uniform(-0.5, 0.9) * reach)
        R = R @ Rotation.from_rotvec(rng.normal(0.0, 0.25, 3)).as_matrix()
        mesh = box(np.asarray(size)) if board else cylinder(size[0], size[1], 16)
        if not board:
            R = R @ _R_ROD
        X = transform(R, X_world_camera[:3, 3] + share * sight + p)
        bodies.append(Body(mesh, X, surfaces.material(rng), OBJECT))
    return bodies
