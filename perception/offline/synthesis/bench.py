"""A table with what rests on it: tools that lie, stand and lean, what they lean on, objects and small parts."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, inverse, random_rotation, rotation_z, transform, transform_points
from toolee_robot.perception.offline.dataset.records import FARTHEST, NEAREST
from toolee_robot.perception.offline.synthesis.clutter import Surfaces, any_object, corners_of, settled
from toolee_robot.perception.offline.synthesis.placement import Stance, on_plane, random_pixel
from toolee_robot.perception.offline.synthesis.resting import Support, across, leaning, lying, standing
from toolee_robot.render import Body
from toolee_robot.render.mesh import box
from toolee_robot.tools import ToolShape
from toolee_robot.types import CameraIntrinsics

_STANCES = (Stance.LYING, Stance.STANDING, Stance.LEANING, Stance.STACKED)
_SHARES = (0.42, 0.18, 0.2, 0.2)
"""Shares of the stances that are tried; a tool that cannot stand, or finds no other one to lie on, lies."""
_CLEARANCE = 0.006
"""Least distance of tools that do not touch, and of tools and hands [m], between points some 5 to 10 mm apart."""
_TRIES = 8
_SAMPLES = 1500
_SIDES = Rotation.from_euler("x", [[0.0], [np.pi / 2]]).as_matrix()
"""Upright and on its side."""


class Bench:
    """A table in the view of a camera, on which tools and objects are placed one after the other.

    Args:
        height: Height of the table top, world frame [m].
        intrinsics: Intrinsics of the camera.
        X_world_camera: Pose of the camera in the world frame, 4x4 [m].
        surfaces: Surfaces of the split.
        taken: Points that tools keep away from, such as those of hands, world frame, (N, 3) [m] each.
        body_id: Body id of supports and objects.

    Attributes:
        height: Height of the table top, world frame [m].
        bodies: Supports and objects.
    """

    def __init__(
        self,
        height: float,
        intrinsics: CameraIntrinsics,
        X_world_camera: Array,
        surfaces: Surfaces,
        taken: list[Array],
        body_id: int,
    ) -> None:
        self.bodies: list[Body] = []
        self.height, self._intrinsics, self._X_world_camera = height, intrinsics, X_world_camera
        self._surfaces, self._body_id = surfaces, body_id
        self._taken = list(taken)
        self._lower: list[tuple[int, Array]] = []  # tools to lie on: index into _taken, and points of the surface
        self._supports: list[Support] = []
        self._feet: list[Array] = []

    def place(self, tool: ToolShape, rng: np.random.Generator) -> tuple[Array, Stance] | None:
        """Place a tool where the camera sees it.

        Args:
            tool: The tool.
            rng: Random generator.

        Returns:
            X_world_tool, 4x4 [m], and how the tool rests; None if there is no free place in view.
        """
        for _ in range(_TRIES):
            point = self._point(rng, 0.08, NEAREST, FARTHEST)
            if point is None:
                continue
            X, stance, support, below = self._posed(tool, point, rng)
            points = transform_points(X, tool.sample_surface(_SAMPLES, rng)[0])
            if not self._free(points, support, below):
                continue
            if support is not None:
                material = self._surfaces.material(rng, 0.1)
                self.bodies.append(Body(box(support.size), support.X_world_box, material, self._body_id))
                self._supports.append(support)
                self._feet.append(support.X_world_box[:3, 3][None])
            if stance is Stance.LYING:
                self._lower.append((len(self._taken), transform_points(X, tool.sample_surface(4 * _SAMPLES, rng)[0])))
            self._taken.append(points)
            self._feet.append(points[points[:, 2] < self.height + 0.01])
            return X, stance
        return None

    def add_object(self, rng: np.random.Generator, size: float) -> bool:
        """Put an object on the table; it is left out where it would hit a tool.

        Args:
            rng: Random generator.
            size: Approximate size [m].

        Returns:
            Whether the camera sees the table at the place drawn.
        """
        point = self._point(rng, -0.1, 0.3, 1.6)
        if point is not None:
            self._set_down(point, rng, size)
        return point is not None

    def add_small_parts(self, rng: np.random.Generator, count: int) -> None:
        """Strew small parts, of 8 to 50 mm, about the tools.

        Args:
            rng: Random generator.
            count: Number of parts to try.
        """
        for _ in range(count if self._feet else 0):
            about = self._feet[int(rng.integers(len(self._feet)))]
            point = np.array([*about[:, :2].mean(axis=0) + rng.normal(0.0, 0.09, 2), self.height])
            self._set_down(point, rng, float(np.exp(rng.uniform(np.log(0.008), np.log(0.05)))))

    def top(self, rng: np.random.Generator, body_id: int) -> Body:
        """Draw the table top (or the ground), large enough for what rests on it.

        Args:
            rng: Random generator.
            body_id: Its body id.

        Returns:
            The body.
        """
        size = rng.uniform(0.6, 2.5, 2)
        ahead = self._X_world_camera[:3, 2] * rng.uniform(0.3, 1.0)
        X = transform(rotation_z(rng.uniform(0, np.pi)), (ahead[0], ahead[1], self.height - 0.02))
        if self._feet:
            feet = transform_points(inverse(X), np.concatenate(self._feet))
            size = np.maximum(size, 2.0 * np.abs(feet[:, :2]).max(axis=0) + rng.uniform(0.02, 0.3))
        return Body(box((float(size[0]), float(size[1]), 0.04)), X, self._surfaces.material(rng, 0.1), body_id)

    def _point(self, rng: np.random.Generator, margin: float, nearest: float, farthest: float) -> Array | None:
        pixel = random_pixel(rng, margin)
        return on_plane(self._intrinsics, self._X_world_camera, self.height, pixel, nearest, farthest)

    def _posed(
        self, tool: ToolShape, point: Array, rng: np.random.Generator
    ) -> tuple[Array, Stance, Support | None, int]:
        """Pose and stance, what the tool leans on, and the index into `_taken` of what it lies on, -1 for none."""
        stance = _STANCES[int(rng.choice(len(_STANCES), p=_SHARES))]
        X: Array | None = None
        if stance is Stance.STANDING:
            X = standing(tool, point, rng)
        elif stance is Stance.LEANING:
            X, support = leaning(tool, point, self._X_world_camera[:3, 2], rng)
            return X, stance, support, -1
        elif stance is Stance.STACKED and self._lower:
            index, below = self._lower[int(rng.integers(len(self._lower)))]
            X = across(tool, below, self.height, rng)
            if X is not None:
                return X, stance, None, index
        if X is None:
            return lying(tool, point, rng), Stance.LYING, None, -1
        return X, stance, None, -1

    def _free(self, points: Array, support: Support | None, below: int) -> bool:
        """Whether a tool hits nothing, neither what stands there nor by what it leans on."""
        there = [p for k, p in enumerate(self._taken) if k != below]
        if there:
            all_points = np.concatenate(there)
            if np.isfinite(KDTree(all_points).query(points, distance_upper_bound=_CLEARANCE)[0]).any():
                return False
            if support is not None and _inside(support, all_points):
                return False
        return not any(_inside(other, points) for other in self._supports)

    def _set_down(self, point: Array, rng: np.random.Generator, size: float) -> None:
        R = rotation_z(rng.uniform(0, 2 * np.pi)) @ _SIDES[int(rng.random() < 0.4)]
        if rng.random() < 0.15:
            R = random_rotation(rng)
        bodies = settled(any_object(rng, self._surfaces, transform(R, point), self._body_id, size), self.height)
        corners = corners_of(bodies)
        centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        radius = 0.8 * np.linalg.norm(corners - centre, axis=1).max()
        if self._taken and KDTree(np.concatenate(self._taken)).query(centre)[0] < radius:
            return
        self.bodies += bodies
        self._feet.append(centre[None])


def _inside(support: Support, points: Array) -> bool:
    """Whether any of the points is in the box."""
    local = np.abs(transform_points(inverse(support.X_world_box), points))
    return bool((local < support.size / 2).all(axis=1).any())
