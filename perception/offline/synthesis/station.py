"""Scenes with a fixed plan: the paper's protocol, and the station's UR10 with a hand that shows a tool.

The paper: one upright tool in one hand, fixed grasp, camera without roll. The images of the paper are 1920x1080 with a
field of view of about 90 degrees. Here the full image is 960x540 with the same field of view; a window of 512x424 with
the tool is rendered, and the EE circle of 60 pixels becomes one of 30.

The station: a tool is shown to the fixed camera, above block and nail. Dimensions and positions are those of
`toolee_robot.station`, repeated here as centres of random ranges: a training machine does not need the packages of the
configuration, and a real station deviates from the defaults.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.perception.offline.dataset.records import (
    CIRCLE,
    FOCAL,
    FULL_HEIGHT,
    FULL_WIDTH,
    HEIGHT,
    SCENES,
    SHOWN_HAND,
    WIDTH,
)
from toolee_robot.perception.offline.synthesis.bodies import (
    Grasp,
    HandStyle,
    X_base_hand_of,
    arm_bodies,
    hand_bodies,
    tool_bodies,
    tuple_of,
)
from toolee_robot.perception.offline.synthesis.clutter import Surfaces, walls
from toolee_robot.perception.offline.synthesis.hard import ARM, HAND, OBJECT, ROOM
from toolee_robot.perception.offline.synthesis.placement import (
    PlacedTool,
    Pool,
    SceneSample,
    Stance,
    X_world_hand_of,
    look,
    sees_an_ee,
)
from toolee_robot.render import Body, Material, Scene
from toolee_robot.render.lab import environment, lamps
from toolee_robot.render.material import any_color, finish, linear, skin_tone
from toolee_robot.render.mesh import box, cylinder, sphere
from toolee_robot.robots import wrap_fingers
from toolee_robot.robots.description import arm_tree
from toolee_robot.tools import ToolShape
from toolee_robot.types import CameraIntrinsics

DEPTHS = (0.42, 0.98)
_FULL = CameraIntrinsics(FOCAL, FOCAL, FULL_WIDTH / 2 - 0.5, FULL_HEIGHT / 2 - 0.5, FULL_WIDTH, FULL_HEIGHT)
_MARGIN = 60.0
_SHIFT = 0.05
_HAND, _ROOM = 101, 100
_SKIN = Material(linear((0.78, 0.60, 0.50)), roughness=0.55)


def paper_scene(rng: np.random.Generator, pool: Pool) -> SceneSample:
    """Generate a scene of the protocol.

    A right hand holds a tool with vertical handle in the nominal grasp, shifted by up to 5 cm along the handle. The
    camera has no roll. An EE is anywhere in the image, see `_any_view`.

    Args:
        rng: Random generator.
        pool: Tools, grasps and surfaces.

    Returns:
        The scene, with the camera.
    """
    tool = pool.tool(rng)
    X_world_camera, X_world_tool = _any_view(rng, tool)
    grasp = shown_grasp(tool.handle.grip_radius)
    along = float(np.clip(rng.uniform(-_SHIFT, _SHIFT), tool.handle.z_min + 0.03, max(tool.handle.z_max, 0.0)))
    X_world_hand = X_world_hand_of(X_world_tool @ transform(p=(0.0, 0.0, along)), grasp.X_hand_tool)

    # The window contains the centre of the tool with an offset and lies within the full image.
    offset = rng.uniform([-80.0, -60.0], [80.0, 60.0])
    vertices = transform_points(np.linalg.inv(X_world_camera) @ X_world_tool, np.asarray(tool.mesh.vertices))
    pixels = vertices[:, :2] / np.maximum(vertices[:, 2:], 0.1) * FOCAL + [_FULL.cx, _FULL.cy]
    middle = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0)) + offset
    corner = np.clip(np.round(middle - [WIDTH / 2, HEIGHT / 2]), 0, [FULL_WIDTH - WIDTH, FULL_HEIGHT - HEIGHT])
    window = CameraIntrinsics(FOCAL, FOCAL, _FULL.cx - float(corner[0]), _FULL.cy - float(corner[1]), WIDTH, HEIGHT)
    bodies = hand_bodies(grasp, HandStyle(False, _SKIN, _SKIN, _SKIN), X_world_hand, _HAND)
    bodies += tool_bodies(tool, X_world_tool, 1, rng, repaint=True)
    bodies += walls(rng, pool.surfaces, _ROOM, min(float((X_world_tool @ [0, 0, tool.handle.z_min, 1])[2]), 0.0) - 0.8)
    placed = PlacedTool(tool, X_world_tool, X_world_hand, False, 1, Stance.HELD)
    scene = Scene(bodies, lamps(rng), environment(rng))
    return SceneSample(scene, window, X_world_camera, (placed,), SCENES.index("paper"), CIRCLE)


@lru_cache(maxsize=64)
def shown_grasp(radius: float) -> Grasp:
    """The nominal grasp of a handle of a radius [m]."""
    X_hand_tool = SHOWN_HAND.grasp.X_hand_tool(radius)
    return Grasp(X_hand_tool, wrap_fingers(SHOWN_HAND, X_hand_tool, radius), radius)


def _any_view(rng: np.random.Generator, tool: ToolShape) -> tuple[Array, Array]:
    """An EE at any pixel, 0.42 to 0.98 m deep; any turn about the handle; a camera's pitch of -45 to 30 degrees.

    Returns:
        X_world_camera and X_world_tool, 4x4 [m].
    """
    pitch = np.deg2rad(rng.uniform(-45.0, 30.0))
    X_world_camera = look(np.zeros(3), np.array([np.cos(pitch), 0.0, np.sin(pitch)]), 0.0)
    ee = tool.ees[int(rng.integers(len(tool.ees)))]
    pixel = rng.uniform([_MARGIN, _MARGIN], [FULL_WIDTH - _MARGIN, FULL_HEIGHT - _MARGIN])
    p = X_world_camera[:3, :3] @ _FULL.rays(pixel) * rng.uniform(*DEPTHS)
    R = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    return X_world_camera, transform(R, p - R @ ee.X_tool_ee[:3, 3])


_CAMERA = np.array([0.95, -0.62, 0.85])
_TARGET = np.array([0.60, -0.15, 0.72])
_NAIL = np.array([0.75, 0.10])
_POSTURES = 150_000


@lru_cache(maxsize=1)
def _postures() -> tuple[Array, Array]:
    """Arm postures (N, 6) [rad] with the hand near the view of the camera, and their X_base_flange (N, 4, 4) [m]."""
    rng = np.random.default_rng(7)
    q = rng.uniform([-3.1, -2.6, -2.6, -3.1, -3.1, -3.1], [3.1, -0.4, 2.6, 3.1, 3.1, 3.1], (_POSTURES, 6))
    X = np.broadcast_to(np.eye(4), (_POSTURES, 4, 4))
    heights = []
    i = 0
    for link in arm_tree().links:
        X = X @ link.X_parent_joint
        if link.axis is not None:
            turn = np.broadcast_to(np.eye(4), (_POSTURES, 4, 4)).copy()
            turn[:, :3, :3] = Rotation.from_rotvec(q[:, i : i + 1] * link.axis).as_matrix()
            X = X @ turn
            heights.append(X[:, 2, 3])
            i += 1
    palm = X[:, :3, 3] + 0.27 * X[:, :3, 2]
    near = np.linalg.norm(palm - (0.15 * _CAMERA + 0.85 * _TARGET), axis=1) < 0.25
    clear = (np.min(heights[2:], axis=0) > 0.12) & (palm[:, 2] > 0.3)
    # The arm must not be between hand and camera.
    away = np.linalg.norm(palm - _CAMERA, axis=1) < np.linalg.norm(X[:, :3, 3] - _CAMERA, axis=1) + 0.15
    keep = near & clear & away
    return q[keep], X[keep]


def station_scene(rng: np.random.Generator, pool: Pool) -> SceneSample | None:
    """Generate a station scene: a UR10 with a hand shows a tool to the camera.

    Args:
        rng: Random generator.
        pool: Tools, grasps and surfaces.

    Returns:
        The scene, with the camera; None if the camera sees no EE in the chosen posture.
    """
    f = 365.5 * np.exp(rng.normal(0.0, 0.03))
    cx, cy = rng.normal([254.9, 205.4], 4.0)
    intrinsics = CameraIntrinsics(float(f), float(f), float(cx), float(cy), WIDTH, HEIGHT)
    X_base_camera = look(_CAMERA + rng.normal(0.0, 0.06, 3), _TARGET + rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.05))
    tool = pool.tool_with(Category.HAMMER_HEAD, rng) if rng.random() < 0.75 else pool.tool(rng)
    grasp = pool.grasp(tool, rng)
    q_arm = _posture(rng, tool, grasp, X_base_camera)
    X_base_hand = X_base_hand_of(q_arm, grasp.q_hand)
    X_base_tool = X_base_hand @ grasp.X_hand_tool @ transform(p=(0.0, 0.0, rng.uniform(-0.03, 0.03)))
    X_camera_tool = inverse(X_base_camera) @ X_base_tool
    lowest = transform_points(X_base_tool, np.asarray(tool.mesh.vertices))[:, 2].min()
    if lowest < 0.02 or not sees_an_ee(tool, X_camera_tool, intrinsics):
        return None
    room = pool.surfaces.laboratory(rng, ROOM)
    bodies = [*room.bodies, *arm_bodies(q_arm, np.eye(4), ARM, rng), *_work(rng, pool.surfaces)]
    bodies += hand_bodies(grasp, _robot_hand(rng), X_base_hand, HAND)
    bodies += tool_bodies(tool, X_base_tool, 1, rng)
    if rng.random() < 0.35:
        bodies += _person(rng)
    scene = Scene(bodies, room.lights, room.environment)
    placed = PlacedTool(tool, X_base_tool, X_base_hand, False, 1, Stance.HELD)
    return SceneSample(scene, intrinsics, X_base_camera, (placed,), 1)


def _posture(rng: np.random.Generator, tool: ToolShape, grasp: Grasp, X_base_camera: Array) -> Array:
    """Random joint positions of the arm (6,) [rad].

    With probability 0.5 the working EE is shown as by the view planner: near, z axis 20 to 65 deg off the line of
    sight; otherwise the posture is random, mostly with the forearm pointing down.
    """
    q, Xs_base_flange = _postures()
    if rng.random() < 0.5:
        X_flange_ee = inverse(Xs_base_flange[0]) @ X_base_hand_of(q[0], grasp.q_hand)
        X_flange_ee = X_flange_ee @ grasp.X_hand_tool @ tool.ees[0].X_tool_ee
        Xs_camera_ee = inverse(X_base_camera) @ Xs_base_flange @ X_flange_ee
        p = Xs_camera_ee[:, :3, 3]
        distance = np.linalg.norm(p, axis=1)
        facing = -np.einsum("ni,ni->n", p, Xs_camera_ee[:, :3, 2]) / distance
        tangent = np.abs(p[:, :2]) / np.maximum(p[:, 2:], 1e-6)
        seen = (p[:, 2] > 0.3) & (distance < 0.68) & (facing > np.cos(np.deg2rad(65.0)))
        shown = np.flatnonzero(seen & (facing < np.cos(np.deg2rad(20.0))) & (tangent < [0.6, 0.48]).all(axis=1))
        if len(shown):
            return q[int(rng.choice(shown))]
    down = np.flatnonzero(Xs_base_flange[:, 2, 2] < -0.5)
    return q[int(rng.choice(down)) if rng.random() < 0.6 else int(rng.integers(len(q)))]


def _robot_hand(rng: np.random.Generator) -> HandStyle:
    """Appearance of the hand: mostly the black of the Shadow Hand, otherwise random."""
    style = HandStyle.random(rng)
    if rng.random() < 0.65:
        black = finish("plastic", tuple_of(rng.uniform(0.05, 0.35)), float(rng.uniform(0.3, 0.6)), 0.0, rng)
        metal = finish("aluminium", tuple_of(rng.uniform(0.08, 0.6)), 0.45, float(rng.uniform(0.0, 0.8)), rng)
        style = HandStyle(False, black, finish("rubber", tuple_of(rng.uniform(0.1, 0.6)), 0.8, 0.0, rng), metal)
    return HandStyle(False, style.palm, style.tips, style.sleeve)


def _work(rng: np.random.Generator, surfaces: Surfaces) -> list[Body]:
    """Stand, wooden block and nail."""
    x, y = _NAIL + rng.normal(0.0, 0.03, 2)
    stand_height, block = float(rng.uniform(0.12, 0.28)), rng.uniform([0.08, 0.08, 0.04], [0.16, 0.16, 0.09])
    stand_size = float(rng.uniform(0.07, 0.12))
    wood = finish("wood_block", (0.80, 0.63, 0.42), 0.6, 0.0, rng, axis=int(rng.integers(2)))
    stand = finish("aluminium", tuple_of(rng.uniform(0.25, 0.7)), 0.4, 0.6, rng)
    if rng.random() < 0.3:
        stand = surfaces.material(rng)
    steel = finish("steel_bright", (0.7, 0.7, 0.72), 0.3, 1.0, rng)
    top = stand_height + float(block[2])
    out = float(rng.uniform(0.0, 0.03))
    head = float(rng.uniform(0.002, 0.004))
    return [
        Body(box((stand_size, stand_size, stand_height)), transform(p=(x, y, stand_height / 2)), stand, OBJECT),
        Body(box(block), transform(p=(x, y, stand_height + block[2] / 2)), wood, OBJECT),
        Body(cylinder(0.0013, out + 0.001, 12), transform(p=(x, y, top + out / 2)), steel, OBJECT),
        Body(cylinder(head, 0.0012, 16), transform(p=(x, y, top + out)), steel, OBJECT),
    ]


def _person(rng: np.random.Generator) -> list[Body]:
    """A person behind the table: trunk, head and arms as simple solids."""
    angle = rng.uniform(0.3, 2.8)
    place = np.array([0.5, 0.2, 0.0]) + rng.uniform(0.6, 1.4) * np.array([np.cos(angle), np.sin(angle), 0.0])
    shirt = finish("rubber", any_color(rng), 0.9, 0.0, rng)
    skin = finish("skin", skin_tone(rng), 0.6, 0.0, rng)
    height = float(rng.uniform(0.55, 0.85))
    trunk = cylinder(0.17, 0.65, 24, 0.19)
    bodies = [
        Body(trunk, transform(p=(place[0], place[1], height - 0.45)), shirt, OBJECT),
        Body(cylinder(0.055, 0.12, 16), transform(p=(place[0], place[1], height - 0.07)), skin, OBJECT),
        Body(sphere(0.11), transform(p=(place[0], place[1], height + 0.08)), skin, OBJECT),
    ]
    for side in (-1.0, 1.0):
        R = Rotation.from_euler("xyz", [rng.uniform(-0.8, 0.8), rng.uniform(-0.8, 0.8), rng.uniform(0, 2 * np.pi)])
        shoulder = place + Rotation.from_euler("z", angle).apply([0.0, 0.23 * side, 0.0]) + [0.0, 0.0, height - 0.2]
        bodies.append(
            Body(cylinder(0.045, 0.5, 16, 0.05), transform(R, shoulder - R.apply([0, 0, 0.2])), shirt, OBJECT)
        )
    return bodies
