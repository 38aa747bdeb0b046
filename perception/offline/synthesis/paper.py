"""Scenes of the protocol of the paper: one upright tool in one hand, fixed grasp, camera without roll.

The images of the paper are 1920x1080 with a field of view of about 90 degrees. Here the full image is 960x540 with the
same field of view; a window of 512x424 with the tool is rendered, and the EE circle of 60 pixels becomes one of 30.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.frames import transform, transform_points
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
from toolee_robot.perception.offline.synthesis.bodies import Grasp, HandStyle, hand_bodies, tool_bodies
from toolee_robot.perception.offline.synthesis.clutter import walls
from toolee_robot.perception.offline.synthesis.placement import (
    PlacedTool,
    Pool,
    SceneSample,
    Stance,
    X_world_hand_of,
    look,
)
from toolee_robot.render import Material, Scene
from toolee_robot.render.lab import environment, lamps
from toolee_robot.render.palette import linear
from toolee_robot.robots import wrap_fingers
from toolee_robot.types import CameraIntrinsics

DEPTHS = (0.42, 0.98)
_MARGIN = 60.0
_SHIFT = 0.05
_TURNS = 6
_HAND, _ROOM = 101, 100
_SKIN = Material(linear((0.78, 0.60, 0.50)), roughness=0.55)


def paper_scene(rng: np.random.Generator, pool: Pool, claws: bool = False) -> SceneSample:
    """Generate a scene of the protocol.

    A right hand holds a tool with vertical handle in the nominal grasp, shifted by up to 5 cm along the handle. An EE
    is at a depth of 0.42 to 0.98 m; the pitch of the camera is -45 to 30 degrees, its roll 0.

    Args:
        rng: Random generator.
        pool: Tools, grasps and surfaces.
        claws: Show a tool with a claw, and of `_TURNS` rotations about the handle the one with the best view of the
            face: the head is in front of the claw, which is the hardest view of the protocol and a rare one.

    Returns:
        The scene, with the camera.
    """
    tool = pool.tool_with(Category.HAMMER_GRIP, rng) if claws else pool.tool(rng)
    pitch = np.deg2rad(rng.uniform(-45.0, 30.0))
    X_world_camera = look(np.zeros(3), np.array([np.cos(pitch), 0.0, np.sin(pitch)]), 0.0)
    full = CameraIntrinsics(FOCAL, FOCAL, FULL_WIDTH / 2 - 0.5, FULL_HEIGHT / 2 - 0.5, FULL_WIDTH, FULL_HEIGHT)
    ee = tool.ees[int(rng.integers(len(tool.ees)))]
    pixel = rng.uniform([_MARGIN, _MARGIN], [FULL_WIDTH - _MARGIN, FULL_HEIGHT - _MARGIN])
    p = X_world_camera[:3, :3] @ full.rays(pixel) * rng.uniform(*DEPTHS)
    turns = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi, _TURNS if claws else 1)[:, None]).as_matrix()
    R = turns[np.argmin(turns @ tool.ees[0].X_tool_ee[:3, 2] @ p)]
    X_world_tool = transform(R, p - R @ ee.X_tool_ee[:3, 3])

    radius = tool.handle.grip_radius
    X_hand_tool = SHOWN_HAND.grasp.X_hand_tool(radius)
    grasp = Grasp(X_hand_tool, wrap_fingers(SHOWN_HAND, X_hand_tool, radius), radius)
    along = float(np.clip(rng.uniform(-_SHIFT, _SHIFT), tool.handle.z_min + 0.03, max(tool.handle.z_max, 0.0)))
    X_world_hand = X_world_hand_of(X_world_tool @ transform(p=(0.0, 0.0, along)), X_hand_tool)

    # The window contains the centre of the tool with a random offset and lies within the full image.
    vertices = transform_points(np.linalg.inv(X_world_camera) @ X_world_tool, np.asarray(tool.mesh.vertices))
    pixels = vertices[:, :2] / np.maximum(vertices[:, 2:], 0.1) * FOCAL + [full.cx, full.cy]
    middle = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0)) + rng.uniform([-80.0, -60.0], [80.0, 60.0])
    corner = np.clip(np.round(middle - [WIDTH / 2, HEIGHT / 2]), 0, [FULL_WIDTH - WIDTH, FULL_HEIGHT - HEIGHT])
    window = CameraIntrinsics(FOCAL, FOCAL, full.cx - float(corner[0]), full.cy - float(corner[1]), WIDTH, HEIGHT)
    bodies = hand_bodies(grasp, HandStyle(False, _SKIN, _SKIN, _SKIN), X_world_hand, _HAND)
    bodies += tool_bodies(tool, X_world_tool, 1, rng, repaint=True)
    bodies += walls(rng, pool.surfaces, _ROOM, min(float((X_world_tool @ [0, 0, tool.handle.z_min, 1])[2]), 0.0) - 0.8)
    placed = PlacedTool(tool, X_world_tool, X_world_hand, False, 1, Stance.HELD)
    scene = Scene(bodies, lamps(rng), environment(rng))
    return SceneSample(scene, window, X_world_camera, (placed,), SCENES.index("paper"), CIRCLE)
