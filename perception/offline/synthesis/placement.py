"""Placement in synthetic scenes: poses in the view of a camera and in a hand; the pool of tools."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import (
    Array,
    frame_from_axes,
    inverse,
    random_rotation,
    rotation_z,
    transform,
)
from toolee_robot.perception.offline.dataset.catalogue import GENERATED, Catalogue
from toolee_robot.perception.offline.dataset.records import FARTHEST, HEIGHT, NEAREST, WIDTH
from toolee_robot.perception.offline.synthesis.bodies import Grasp, random_grasp
from toolee_robot.perception.offline.synthesis.clutter import Surfaces
from toolee_robot.render import Scene
from toolee_robot.tools import ToolShape
from toolee_robot.types import CameraIntrinsics

_GRASP_RADII = (0.006, 0.009, 0.012, 0.0145, 0.017, 0.021)
_GRASPS_EACH = 2


@dataclass(frozen=True, eq=False)
class Pool:
    """Tools and grasps shared by the examples of one scene folder.

    They are created on first use and cached, because creating them takes longer than rendering an example.

    Attributes:
        catalogue: Catalogue of the tools.
        tools: Numbers of the tools in the catalogue.
        surfaces: Surfaces of the split.
    """

    catalogue: Catalogue
    tools: tuple[int, ...]
    surfaces: Surfaces
    _grasp_seed: int
    _grasps: dict[int, Grasp]

    @staticmethod
    def random(rng: np.random.Generator, split: str, catalogue: Catalogue = GENERATED) -> Pool:
        """Draw a pool of tools of a split.

        Args:
            rng: Random generator.
            split: "train" or "test" (held out).
            catalogue: Tools to choose from.

        Returns:
            The pool.
        """
        return Pool(catalogue, catalogue.pool(rng, split), Surfaces(split), int(rng.integers(2**31)), {})

    def tool(self, rng: np.random.Generator) -> ToolShape:
        """A random tool of the pool."""
        return self._any(self.tools, rng)

    def tool_with(self, ee: Category, rng: np.random.Generator) -> ToolShape:
        """Draw a tool of the pool with an EE of a category; of all its tools if none has one.

        Args:
            ee: The category.
            rng: Random generator.

        Returns:
            The tool.
        """
        such = [n for n in self.tools if ee in self.catalogue.listed(n).categories]
        return self._any(such or self.tools, rng)

    def _any(self, numbers: Sequence[int], rng: np.random.Generator) -> ToolShape:
        return self.catalogue.tool(numbers[int(rng.integers(len(numbers)))])

    def grasp(self, tool: ToolShape, rng: np.random.Generator) -> Grasp:
        """Draw a grasp for about the radius of a tool's handle.

        Args:
            tool: The tool.
            rng: Random generator.

        Returns:
            The grasp.
        """
        radius = tool.handle.grip_radius
        nearest = int(np.argmin(np.abs(np.asarray(_GRASP_RADII) - radius)))
        return self._grasp(nearest * _GRASPS_EACH + int(rng.integers(_GRASPS_EACH)))

    def any_grasp(self, rng: np.random.Generator) -> Grasp:
        """A random grasp for any radius."""
        return self._grasp(int(rng.integers(len(_GRASP_RADII) * _GRASPS_EACH)))

    def _grasp(self, number: int) -> Grasp:
        if number not in self._grasps:
            rng = np.random.default_rng([self._grasp_seed, number])
            self._grasps[number] = random_grasp(_GRASP_RADII[number // _GRASPS_EACH], rng)
        return self._grasps[number]


class Stance(StrEnum):
    """How a tool is placed: in a hand, in the air, or at rest on a plane, a support or another tool."""

    HELD = "held"
    FLOATING = "floating"
    LYING = "lying"
    STANDING = "standing"
    LEANING = "leaning"
    STACKED = "stacked"


@dataclass(frozen=True, eq=False)
class PlacedTool:
    """A tool in a scene.

    Attributes:
        tool: The tool.
        X_world_tool: Pose of the tool in the world frame, 4x4 [m].
        X_world_hand: Pose of the hand frame in the world frame, 4x4 [m]; None if no hand holds the tool.
        mirrored: Whether a left hand holds it.
        body_id: Id of the tool in the images, 1..3.
        stance: How it is placed.
    """

    tool: ToolShape
    X_world_tool: Array
    X_world_hand: Array | None
    mirrored: bool
    body_id: int
    stance: Stance


@dataclass(frozen=True, eq=False)
class SceneSample:
    """A scene to be rendered, with its camera and tools.

    Attributes:
        scene: The scene.
        intrinsics: Intrinsics of the camera.
        X_world_camera: Pose of the camera in the world frame, 4x4 [m].
        tools: Tools in the scene.
        kind: Kind of scene, an index into `records.SCENES`.
        circle: Radius [px] about the EE origin that delimits the mask of an EE; None: a sphere of
            `EndEffectorSpec.radius` delimits it.
    """

    scene: Scene
    intrinsics: CameraIntrinsics
    X_world_camera: Array
    tools: tuple[PlacedTool, ...]
    kind: int
    circle: float | None = None


def random_intrinsics(rng: np.random.Generator) -> CameraIntrinsics:
    """Random intrinsics: focal length 0.6 to 1.6 image widths, or that of a Kinect v2 (one third); centre perturbed."""
    f = 365.5 * np.exp(rng.normal(0.0, 0.01)) if rng.random() < 0.33 else WIDTH * rng.uniform(0.6, 1.6)
    cx, cy = rng.normal([WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5], [8.0, 8.0])
    return CameraIntrinsics(float(f), float(f), float(cx), float(cy), WIDTH, HEIGHT)


def look(position: Array, target: Array, roll: float) -> Array:
    """Pose of a camera from its viewing direction.

    Args:
        position: Position of the camera (3,) [m], world frame.
        target: Point on the optical axis (3,) [m], world frame.
        roll: Rotation about the optical axis [rad]; at 0, the up direction of the image is towards world z.

    Returns:
        X_world_camera (4x4) [m], OpenCV axes.
    """
    z = np.asarray(target) - np.asarray(position)
    right = np.cross(z, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6 * np.linalg.norm(z):
        right = np.array([1.0, 0.0, 0.0])
    return frame_from_axes(z=z, x=right, p=position) @ transform(rotation_z(roll))


def random_pixel(rng: np.random.Generator, margin: float = 0.08) -> Array:
    """Draw a pixel, uniform in the image without a margin.

    Args:
        rng: Random generator.
        margin: Margin as a share of the side; a negative one extends the image.

    Returns:
        The pixel (x, y) [px].
    """
    return rng.uniform([margin * WIDTH, margin * HEIGHT], [(1 - margin) * WIDTH, (1 - margin) * HEIGHT])


def tool_in_view(tool: ToolShape, intrinsics: CameraIntrinsics, rng: np.random.Generator) -> Array:
    """Random pose of a tool in view of the camera.

    The orientation is uniform; an EE or, with probability 0.25, the grip centre projects into the image at a depth of
    0.4 to 1.1 m.

    Args:
        tool: The tool.
        intrinsics: Intrinsics of the camera.
        rng: Random generator.

    Returns:
        X_camera_tool (4x4) [m].
    """
    R = random_rotation(rng)
    anchor = np.zeros(3)
    if rng.random() < 0.75:
        anchor = tool.ees[int(rng.integers(len(tool.ees)))].X_tool_ee[:3, 3]
    p = intrinsics.rays(random_pixel(rng)) * rng.uniform(NEAREST, FARTHEST)
    return transform(R, p - R @ anchor)


def on_plane(
    intrinsics: CameraIntrinsics,
    X_world_camera: Array,
    height: float,
    pixel: Array,
    nearest: float = 0.3,
    farthest: float = 1.6,
) -> Array | None:
    """Intersection of the ray through a pixel with a horizontal plane.

    Args:
        intrinsics: Intrinsics of the camera.
        X_world_camera: Pose of the camera in the world frame, 4x4 [m].
        height: Height of the plane [m], world frame.
        pixel: Pixel (x, y) [px].
        nearest: Minimum depth [m].
        farthest: Maximum depth [m].

    Returns:
        The point (3,) [m], world frame; None if there is none in the range of depths.
    """
    direction = X_world_camera[:3, :3] @ intrinsics.rays(pixel)
    if direction[2] > -1e-3:
        return None
    depth = (height - X_world_camera[2, 3]) / direction[2]
    if not nearest < depth < farthest:
        return None
    return np.asarray(X_world_camera[:3, 3] + depth * direction)


def sees_an_ee(tool: ToolShape, X_camera_tool: Array, intrinsics: CameraIntrinsics) -> bool:
    """Whether the origin of an EE of the tool is in the image at a depth of 0.4 to 1.1 m.

    Args:
        tool: The tool.
        X_camera_tool: Its pose in the camera frame, (4, 4).
        intrinsics: Intrinsics of the camera.
    """
    for ee in tool.ees:
        p = (X_camera_tool @ ee.X_tool_ee)[:3, 3]
        u, v = intrinsics.project(p)
        if NEAREST < p[2] < FARTHEST and 0 <= u < WIDTH and 0 <= v < HEIGHT:
            return True
    return False


def X_world_hand_of(X_world_tool: Array, X_hand_tool: Array) -> Array:
    """Pose of the hand that holds a tool.

    Args:
        X_world_tool: Pose of the tool in the world, (4, 4).
        X_hand_tool: Pose of the tool in the hand, (4, 4).

    Returns:
        X_world_hand, (4, 4).
    """
    return X_world_tool @ inverse(X_hand_tool)
