"""A table with tools that lie, stand and lean on it, with what they lean on, objects and small parts."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.spatial import ConvexHull, KDTree
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
from toolee_robot.perception.offline.dataset.records import FARTHEST, NEAREST
from toolee_robot.perception.offline.synthesis.clutter import Surfaces, any_object, corners_of, settled
from toolee_robot.perception.offline.synthesis.placement import Stance, on_plane, random_pixel
from toolee_robot.render import Body
from toolee_robot.render.mesh import box
from toolee_robot.tools import ToolShape
from toolee_robot.types import CameraIntrinsics

GAP = 0.0005
"""Distance between a tool and what it rests on [m]: surfaces that touch exactly would flicker."""
_UPRIGHT = 0.75
"""Least cosine between the handle and the vertical of a tool that stands."""
_STEADY = 0.015
"""Tilt that a tool that stands must bear [rad]."""
_CELL = 0.0015
"""Side of a cell of the height map of a lower tool [m]."""
_STEEPEST = 0.9
"""Largest tilt of a tool across another one [rad]."""
_CONTACT_SAMPLES = 5000
"""Points on a tool's surface in the search for its contact with another one."""
_downs: WeakKeyDictionary[ToolShape, Array] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Support:
    """An upright box that a tool leans on.

    Attributes:
        X_world_box: Pose of its centre in the world frame, 4x4 [m].
        size: Side lengths (3,) [m].
    """

    X_world_box: Array
    size: Array


def equilibria(tool: ToolShape) -> Array:
    """Directions that point down when a tool is in equilibrium on a plane.

    Of the facets of the convex hull these are the normals of those that the centre of mass stands above; a tool that
    stands must also bear a tilt of `_STEADY`, which one on the tip of a blade does not.

    Args:
        tool: The tool.

    Returns:
        Unit vectors, `tool` frame, (N, 3); N is at least 1.
    """
    if tool not in _downs:
        vertices = np.asarray(tool.mesh.vertices)
        hull = ConvexHull(vertices)
        normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
        centre = _centre_of_mass(tool)
        feet = centre - (normals @ centre + offsets)[:, None] * normals
        corners = vertices[hull.simplices]
        sides = np.roll(corners, -1, axis=1) - corners
        turns = np.einsum("fkc,fc->fk", np.cross(sides, feet[:, None] - corners), normals)
        area = np.abs(turns.sum(axis=1))
        above = ((turns >= -1e-12).all(axis=1) | (turns <= 1e-12).all(axis=1)) & (area > 1e-9)
        if not above.any():
            above[np.argmin(np.linalg.norm(feet - centre, axis=1))] = True
        downs = np.unique(np.round(normals[above], 4), axis=0)
        upright = np.abs(downs[:, 2]) >= _UPRIGHT
        kept = ~upright | np.array([_steady(vertices[hull.vertices], centre, down) for down in downs])
        _downs[tool] = downs[kept] if kept.any() else downs
    return _downs[tool]


def lying(tool: ToolShape, point: Array, rng: np.random.Generator) -> Array:
    """Draw the pose of a tool that lies on a horizontal plane, in an equilibrium of its convex hull.

    Args:
        tool: The tool.
        point: Point of the plane below the grip or an EE, world frame, (3,) [m].
        rng: Random generator.

    Returns:
        X_world_tool, (4, 4) [m].
    """
    return _dropped(tool, _R_lying(tool, rng), point, rng)


def standing(tool: ToolShape, point: Array, rng: np.random.Generator) -> Array | None:
    """Draw the pose of a tool that stands on a horizontal plane: a hammer on its head, a mallet on its butt.

    Args:
        tool: The tool.
        point: Point of the plane below the grip or an EE, world frame, (3,) [m].
        rng: Random generator.

    Returns:
        X_world_tool, (4, 4) [m]; None if the tool has no such equilibrium.
    """
    downs = equilibria(tool)
    downs = downs[np.abs(downs[:, 2]) >= _UPRIGHT]
    if not len(downs):
        return None
    return _dropped(tool, _R_down(downs[int(rng.integers(len(downs)))], rng), point, rng)


def leaning(tool: ToolShape, point: Array, ahead: Array, rng: np.random.Generator) -> tuple[Array, Support]:
    """Draw the pose of a tool with one end on a horizontal plane and the other one on a wall or the edge of a box.

    Args:
        tool: The tool.
        point: Point of the plane below the grip or an EE, world frame, (3,) [m].
        ahead: Viewing direction of the camera, world frame, (3,): the support is rarely between tool and camera.
        rng: Random generator.

    Returns:
        X_world_tool, (4, 4) [m], and what the tool leans on.
    """
    steep = rng.random() < 0.6
    tilt = rng.uniform(0.8, 1.4) if steep else rng.uniform(0.12, 0.7)
    R = _along_x(_R_lying(tool, rng), rng)
    incline = np.arctan(R[2, 2] / R[0, 2])
    R = Rotation.from_euler("y", incline - tilt).as_matrix() @ R
    vertices = np.asarray(tool.mesh.vertices) @ R.T
    vertices[:, 2] -= vertices[:, 2].min()
    top = float(vertices[:, 2].max())
    height = top + rng.uniform(0.0, 0.3) if rng.random() < 0.4 else top * rng.uniform(0.35, 0.95)
    edge, aside = _reach(vertices, np.asarray(tool.mesh.faces), height)
    size = np.array([rng.uniform(0.02, 0.25), rng.uniform(0.08, 0.6), height])
    place = [edge + GAP + size[0] / 2, aside + rng.uniform(-0.3, 0.3) * size[1], GAP + height / 2]
    turn = np.arctan2(ahead[1], ahead[0]) + rng.uniform(-1.8, 1.8)
    X = _dropped(tool, rotation_z(turn) @ R, point, rng)
    origin = np.array([X[0, 3], X[1, 3], point[2]])
    return X, Support(transform(rotation_z(turn), origin + rotation_z(turn) @ place), size)


def across(tool: ToolShape, below: Array, height: float, rng: np.random.Generator) -> Array | None:
    """Draw the pose of a tool that lies across another one, with one end on the same plane.

    Args:
        tool: The tool.
        below: Points on the surface of the lower tool, world frame, (N, 3) [m].
        height: Height of the plane, world frame [m].
        rng: Random generator.

    Returns:
        X_world_tool, (4, 4) [m]; None if the tools do not touch, or the upper one would be too steep.
    """
    R = _along_x(_R_lying(tool, rng), rng)
    points = tool.sample_surface(_CONTACT_SAMPLES, rng)[0] @ R.T
    low, high = points[:, 0].min(), points[:, 0].max()
    crossing = np.array([low + rng.uniform(0.35, 0.9) * (high - low), np.median(points[:, 1]), 0.0])
    R_turn = rotation_z(rng.uniform(0.0, 2.0 * np.pi))
    target = below[int(rng.integers(len(below)))]
    corner = below[:, :2].min(axis=0) - 2 * _CELL
    cells = np.ceil((below[:, :2].max(axis=0) - corner) / _CELL).astype(int) + 3
    tops = np.full(cells, -np.inf)
    i, j = ((below[:, :2] - corner) / _CELL).astype(int).T
    np.maximum.at(tops, (i, j), below[:, 2])
    tops = maximum_filter(tops, 3)

    vertices = np.asarray(tool.mesh.vertices) @ R.T

    def posed(tilt: float) -> tuple[Array, float]:
        """Pose at a tilt, and the least vertical distance to the lower tool [m]."""
        R_tilt = R_turn @ Rotation.from_euler("y", -tilt).as_matrix()
        p = target - R_tilt @ crossing
        p[2] = height + GAP - (vertices @ R_tilt[2]).min()
        there = points @ R_tilt.T + p
        cell = np.floor((there[:, :2] - corner) / _CELL).astype(int)
        inside = ((cell >= 0) & (cell < cells)).all(axis=1)
        gaps = there[inside, 2] - tops[tuple(cell[inside].T)]
        return transform(R_tilt @ R, p), float(gaps.min(initial=np.inf))

    flat, steep = 0.0, _STEEPEST
    if posed(flat)[1] > GAP or posed(steep)[1] < GAP:
        return None
    while steep - flat > 0.002:
        middle = 0.5 * (flat + steep)
        flat, steep = (middle, steep) if posed(middle)[1] < GAP else (flat, middle)
    return posed(steep)[0]


def _steady(corners: Array, centre: Array, down: Array) -> bool:
    """Whether a tilt by `_STEADY` to any side lifts the centre of mass above the plane."""
    angles = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    aside = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ _two_axes(down)
    tilted = np.cos(_STEADY) * down + np.sin(_STEADY) * aside
    reach = corners - centre
    return bool((reach @ tilted.T).max(axis=0).min() > (reach @ down).max())


def _two_axes(normal: Array) -> Array:
    """Two orthogonal unit vectors in a plane, (2, 3)."""
    aside = np.eye(3)[int(np.argmin(np.abs(normal)))]
    return frame_from_axes(z=normal, x=aside)[:3, :2].T


def _R_down(down: Array, rng: np.random.Generator) -> Array:
    """Rotation that turns a direction of the tool downwards, with a random turn about the vertical."""
    x, y = _two_axes(-down)
    return np.asarray(rotation_z(rng.uniform(0.0, 2.0 * np.pi)) @ np.stack([x, y, -down / np.linalg.norm(down)]))


def _R_lying(tool: ToolShape, rng: np.random.Generator) -> Array:
    """Random orientation of a tool that lies: of all equilibria the nearest one to a random direction."""
    downs = equilibria(tool)
    flat = downs[np.abs(downs[:, 2]) < _UPRIGHT]
    downs = flat if len(flat) else downs
    return _R_down(downs[int(np.argmax(downs @ rng.normal(size=3)))], rng)


def _along_x(R: Array, rng: np.random.Generator) -> Array:
    """The orientation turned about the vertical until the handle points along x, either way round."""
    turn = -np.arctan2(R[1, 2], R[0, 2]) + (np.pi if rng.random() < 0.5 else 0.0)
    return np.asarray(rotation_z(turn) @ R)


def _dropped(tool: ToolShape, R: Array, point: Array, rng: np.random.Generator) -> Array:
    """Pose with an orientation, whose lowest point is on the plane; the grip or an EE is above the point."""
    anchor = np.zeros(3)
    if rng.random() < 0.6:
        anchor = tool.ees[int(rng.integers(len(tool.ees)))].X_tool_ee[:3, 3]
    p = np.asarray(point) - R @ anchor
    p[2] = point[2] + GAP - (np.asarray(tool.mesh.vertices) @ R[2]).min()
    return transform(R, p)


def _reach(vertices: Array, faces: NDArray[np.int64], height: float) -> tuple[float, float]:
    """Largest x of the surface up to a height, and the y of that place [m]."""
    start = vertices[faces]
    end = np.roll(start, -1, axis=1)
    start, end = start.reshape(-1, 3), end.reshape(-1, 3)
    crossing = (start[:, 2] < height) & (end[:, 2] > height)
    a, b = start[crossing], end[crossing]
    cut = a + (b - a) * ((height - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None]
    candidates = np.concatenate([vertices[vertices[:, 2] <= height], cut])
    furthest = candidates[np.argmax(candidates[:, 0])]
    return float(furthest[0]), float(furthest[1])


def _centre_of_mass(tool: ToolShape) -> Array:
    """Approximate centre of mass, `tool` frame, (3,) [m]: each part's outer surface is taken as closed."""
    vertices, faces = np.asarray(tool.mesh.vertices), np.asarray(tool.mesh.faces)
    moment, mass = np.zeros(3), 0.0
    for k, part in enumerate(tool.parts):
        corners = vertices[faces[tool.face_parts == k]]
        if not len(corners):
            continue
        middle = corners.reshape(-1, 3).mean(axis=0)
        a, b, c = np.moveaxis(corners - middle, 1, 0)
        volumes = np.einsum("fc,fc->f", a, np.cross(b, c)) / 6.0
        weight = part.material.density * max(float(volumes.sum()), 0.0)
        if weight > 0.0:
            moment += weight * middle + part.material.density * volumes @ (a + b + c) / 4.0
            mass += weight
    return moment / mass if mass > 0.0 else 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))


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
