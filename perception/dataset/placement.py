"""Where things stand in a synthetic scene: poses in front of a camera, on a table, in a hand; the pool of tools."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, frame_from_axes, inverse, transform, transform_points
from toolee_robot.perception.dataset.bodies import Grasp, random_grasp
from toolee_robot.perception.dataset.records import HEIGHT, WIDTH
from toolee_robot.render import Scene
from toolee_robot.tools import KINDS_BY_FAMILY, Family, Tool, make_tool
from toolee_robot.types import CameraIntrinsics

_GRASP_RADII = (0.006, 0.009, 0.012, 0.0145, 0.017, 0.021)
_GRASPS_EACH = 4
_INSTANCES = 3000
"""Training instances are seeds below this one, of each kind."""


@dataclass(frozen=True, eq=False)
class Pool:
    """The tools and grasps that one block of examples draws from: making them costs more than rendering them."""

    tools: tuple[Tool, ...]
    grasps: tuple[Grasp, ...]

    @staticmethod
    def random(rng: np.random.Generator, split: str) -> Pool:
        """Half hammers, the rest screwdrivers and wrenches; split "train" or "test" (held-out instances)."""
        families = [Family.HAMMERS] * 11 + [Family.SCREWDRIVERS] * 7 + [Family.WRENCHES] * 6
        tools = []
        for family in families:
            kinds = KINDS_BY_FAMILY[family]
            weights = np.ones(len(kinds))
            if family is Family.HAMMERS:
                weights[0] = 6.0  # the only kind with a claw, the fourth category
            kind = kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]
            block = int(rng.integers(_INSTANCES // 5)) * 5
            seed = block + 4 if split == "test" else block + int(rng.integers(4))
            tools.append(make_tool(kind, seed))
        grasps = [random_grasp(radius, rng) for radius in _GRASP_RADII for _ in range(_GRASPS_EACH)]
        return Pool(tuple(tools), tuple(grasps))

    def tool(self, rng: np.random.Generator) -> Tool:
        """Any tool of the pool."""
        return self.tools[int(rng.integers(len(self.tools)))]

    def hammer(self, rng: np.random.Generator) -> Tool:
        """Any hammer of the pool."""
        hammers = [tool for tool in self.tools if tool.kind.family is Family.HAMMERS]
        return hammers[int(rng.integers(len(hammers)))]

    def grasp(self, tool: Tool, rng: np.random.Generator) -> Grasp:
        """A grasp made for about the radius of the tool's handle."""
        radius = float(np.mean(tool.handle.radii_at(0.0)))
        order = np.argsort([abs(grasp.radius - radius) for grasp in self.grasps], kind="stable")
        return self.grasps[int(order[rng.integers(_GRASPS_EACH)])]


@dataclass(frozen=True, eq=False)
class PlacedTool:
    """X_world_tool; X_world_hand or None; body_id: the tool's id (1..3) in the images."""

    tool: Tool
    X_world_tool: Array
    X_world_hand: Array | None
    mirrored: bool
    body_id: int


@dataclass(frozen=True, eq=False)
class SceneSample:
    """A scene to be rendered, and what is in it. kind: 0 hard, 1 station, 2 without tools."""

    scene: Scene
    intrinsics: CameraIntrinsics
    X_world_camera: Array
    tools: tuple[PlacedTool, ...]
    kind: int


def random_intrinsics(rng: np.random.Generator) -> CameraIntrinsics:
    """Focal length 0.6 to 1.3 image widths (a third: a Kinect v2's), the centre a little off."""
    f = 365.5 * np.exp(rng.normal(0.0, 0.01)) if rng.random() < 0.33 else WIDTH * rng.uniform(0.6, 1.3)
    cx, cy = rng.normal([WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5], [8.0, 8.0])
    return CameraIntrinsics(float(f), float(f), float(cx), float(cy), WIDTH, HEIGHT)


def look(position: Array, target: Array, roll: float) -> Array:
    """X_world_camera (OpenCV axes) at `position`, looking at `target`, image up towards world z, rolled [rad]."""
    z = np.asarray(target) - np.asarray(position)
    right = np.cross(z, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6 * np.linalg.norm(z):
        right = np.array([1.0, 0.0, 0.0])
    return frame_from_axes(z=z, x=right, p=position) @ transform(Rotation.from_euler("z", roll))


def ray(intrinsics: CameraIntrinsics, pixel: Array) -> Array:
    """(3,) with z = 1, camera frame, through the pixel (x, y)."""
    x, y = pixel
    return np.array([(x - intrinsics.cx) / intrinsics.fx, (y - intrinsics.cy) / intrinsics.fy, 1.0])


def random_pixel(rng: np.random.Generator, margin: float = 0.08) -> Array:
    """(x, y) uniform in the image less a margin [share of the side]; negative margins reach outside."""
    return rng.uniform([margin * WIDTH, margin * HEIGHT], [(1 - margin) * WIDTH, (1 - margin) * HEIGHT])


def tool_in_view(tool: Tool, intrinsics: CameraIntrinsics, rng: np.random.Generator) -> Array:
    """X_camera_tool: any orientation, with one of its EEs (or, a quarter of the time, its grip) at a pixel of the
    image, 0.35 to 1.1 m away."""
    R = Rotation.random(rng=rng).as_matrix()
    anchor = np.zeros(3)
    if rng.random() < 0.75:
        anchor = tool.ees[int(rng.integers(len(tool.ees)))].X_tool_ee[:3, 3]
    p = ray(intrinsics, random_pixel(rng)) * rng.uniform(0.35, 1.1)
    return transform(R, p - R @ anchor)


def lying(tool: Tool, point: Array, rng: np.random.Generator) -> Array:
    """X_world_tool of a tool that lies flat on a horizontal plane at `point` (3,), on one of its four sides."""
    quarter = Rotation.from_euler("z", int(rng.integers(4)) * np.pi / 2)
    R = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)) * Rotation.from_euler("y", np.pi / 2) * quarter
    X = transform(R, point)
    X[2, 3] += point[2] - transform_points(X, np.asarray(tool.mesh.vertices))[:, 2].min() + 0.0005
    return X


def on_plane(intrinsics: CameraIntrinsics, X_world_camera: Array, height: float, pixel: Array) -> Array | None:
    """(3,) where the ray through the pixel meets the plane z = height, between 0.3 and 1.6 m depth, or None."""
    direction = X_world_camera[:3, :3] @ ray(intrinsics, pixel)
    if direction[2] > -1e-3:
        return None
    depth = (height - X_world_camera[2, 3]) / direction[2]
    if not 0.3 < depth < 1.6:
        return None
    return np.asarray(X_world_camera[:3, 3] + depth * direction)


def sees_an_ee(tool: Tool, X_camera_tool: Array, intrinsics: CameraIntrinsics) -> bool:
    """Whether the origin of one of the tool's EEs is in the image and 0.3 to 1.1 m away."""
    for ee in tool.ees:
        x, y, z = (X_camera_tool @ ee.X_tool_ee)[:3, 3]
        u, v = intrinsics.fx * x / z + intrinsics.cx, intrinsics.fy * y / z + intrinsics.cy
        if 0.3 < z < 1.1 and 0 <= u < WIDTH and 0 <= v < HEIGHT:
            return True
    return False


def X_world_hand_of(X_world_tool: Array, X_hand_tool: Array) -> Array:
    """The palm's pose from the tool's."""
    return X_world_tool @ inverse(X_hand_tool)
