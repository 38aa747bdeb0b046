"""Objects other than tools, such as boxes, cans, cables and brackets, as background, distractors and occluders.

Textures, rooms and backdrops have numbers, of which each fifth is held out: the splits share no surroundings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, random_rotation, rotation_z, transform, transform_points
from toolee_robot.perception.offline.dataset.records import BACKDROPS, ROOMS, TEXTURES, draw
from toolee_robot.render import Body, Material, Mesh, Pattern
from toolee_robot.render.lab import Surroundings, laboratory
from toolee_robot.render.material import Backdrop, Patch, any_color, finish, linear
from toolee_robot.render.mesh import box, cylinder, plane, sphere, tube

_R_WALL = Rotation.from_euler("y", -np.pi / 2)
"""Rotation of the normal of a plane from z to -x."""


def any_object(rng: np.random.Generator, surfaces: Surfaces, X: Array, body_id: int, size: float) -> list[Body]:
    """A random object: a single shape, or a bracket, T or can composed of several.

    Args:
        rng: Random generator.
        surfaces: Surfaces of the split.
        X: Pose of the object in the world frame, 4x4 [m].
        body_id: Body id of all shapes.
        size: Approximate size [m].

    Returns:
        The bodies of its shapes.
    """
    kind = rng.random()
    material = surfaces.material(rng)
    if kind < 0.3:
        return [Body(box(size * rng.uniform(0.15, 1.0, 3)), X, material, body_id)]
    if kind < 0.5:
        top = float(rng.uniform(0.5, 1.0))
        radius = float(size * rng.uniform(0.1, 0.5))
        return [Body(cylinder(radius, float(size * rng.uniform(0.2, 1.2)), 24, top * radius), X, material, body_id)]
    if kind < 0.6:
        return [Body(sphere(float(size * rng.uniform(0.2, 0.5))), X, material, body_id)]
    if kind < 0.75:
        return [Body(cable(rng, 2.0 * size, float(rng.uniform(0.002, 0.009))), X, material, body_id)]
    # A rod with something on it: like a tool in outline, and none.
    length = float(size * rng.uniform(0.8, 1.8))
    radius = float(length * rng.uniform(0.02, 0.07))
    parts = [Body(cylinder(radius, length, 16), X, material, body_id)]
    for _ in range(rng.integers(1, 3)):
        other = surfaces.material(rng)
        place = transform(
            random_rotation(rng) if rng.random() < 0.3 else None, (0.0, 0.0, length * float(rng.uniform(-0.5, 0.5)))
        )
        if rng.random() < 0.5:
            mesh = box(length * rng.uniform(0.05, 0.35, 3))
        else:
            mesh = cylinder(float(length * rng.uniform(0.05, 0.16)), float(length * rng.uniform(0.02, 0.3)), 20)
        parts.append(Body(mesh, X @ place, other, body_id))
    return parts


def corners_of(bodies: Sequence[Body]) -> Array:
    """Vertices of bodies, world frame, (N, 3) [m]."""
    return np.concatenate([transform_points(b.X_world_body, b.mesh.vertices.astype(float)) for b in bodies])


def settled(bodies: Sequence[Body], height: float) -> list[Body]:
    """The bodies of an object, moved up or down together until the lowest point is at a height.

    Args:
        bodies: The bodies.
        height: The height, world frame [m].

    Returns:
        The moved bodies.
    """
    X = transform(p=(0.0, 0.0, height - corners_of(bodies)[:, 2].min()))
    return [replace(body, X_world_body=X @ body.X_world_body) for body in bodies]


def cable(rng: np.random.Generator, length: float, radius: float) -> Mesh:
    """Generate a smooth random cable through the origin.

    Args:
        rng: Random generator.
        length: Approximate length [m].
        radius: Radius [m].

    Returns:
        The cable's mesh [m].
    """
    t = np.linspace(-1.0, 1.0, 32)[:, None]
    bends = rng.normal(0.0, 0.25, (3, 3))
    phases = rng.uniform(0.0, 2 * np.pi, 3)
    waves = sum(bends[k] * np.sin((k + 1) * 1.8 * t + phases[k]) for k in range(3))
    points = length / 2 * (t * np.array([[1.0, 0.0, 0.0]]) + waves)
    return tube(np.asarray(points - points[16]), radius)


def walls(rng: np.random.Generator, surfaces: Surfaces, body_id: int, floor_height: float) -> list[Body]:
    """Generate a random room around the origin: floor, four walls, ceiling and objects.

    Args:
        rng: Random generator.
        surfaces: Surfaces of the split.
        body_id: Body id of all of them.
        floor_height: z of the floor in the world frame [m].

    Returns:
        The bodies.
    """
    floor, ceiling, around = _walls(surfaces, surfaces.room(rng), body_id)
    above = transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, floor_height + 3.5))
    below = Body(plane(14.0), transform(p=(0.0, 0.0, floor_height)), floor, body_id)
    return [below, Body(plane(14.0), above, ceiling, body_id), *around]


@lru_cache(maxsize=ROOMS)
def _walls(surfaces: Surfaces, room: int, body_id: int) -> tuple[Material, Material, tuple[Body, ...]]:
    """Materials of floor and ceiling, and the other bodies of a room."""
    rng = room_rng(room)
    floor, ceiling = surfaces.material(rng, 0.2), surfaces.material(rng, 0.5)
    bodies: list[Body] = []
    wall = surfaces.material(rng, 0.2)
    turn = rng.uniform(0.0, np.pi)
    for k in range(4):
        yaw = turn + k * np.pi / 2
        distance = float(rng.uniform(1.0, 3.5))
        R_yaw = rotation_z(yaw)
        R = Rotation.from_euler("z", yaw) * _R_WALL
        if rng.random() < 0.4:
            wall = surfaces.material(rng, 0.2)
        bodies.append(Body(plane(14.0), transform(R, R_yaw @ [distance, 0.0, 0.0]), wall, body_id))
        for _ in range(rng.integers(0, 5)):
            p = R_yaw @ [distance - rng.uniform(0.1, 0.5), *rng.uniform(-1.2, 1.2, 2)]
            R_object = R_yaw if rng.random() < 0.7 else random_rotation(rng)
            bodies += any_object(rng, surfaces, transform(R_object, p), body_id, float(rng.uniform(0.1, 0.9)))
    return floor, ceiling, tuple(bodies)


def backdrop(rng: np.random.Generator, surfaces: Surfaces) -> Backdrop:
    """Generate a random backdrop: a gradient with patches.

    Args:
        rng: Random generator.
        surfaces: Surfaces of the split.

    Returns:
        The backdrop.
    """
    rng = surfaces.backdrop(rng)
    corners = rng.uniform(0.0, 0.7, (3, 3))
    patches = []
    for _ in range(rng.integers(3, 25)):
        centre = rng.uniform(0.0, 1.0, 2)
        half_axes = 0.3 * rng.uniform(0.05, 1.0, 2) ** 1.5
        angle, oval = float(rng.uniform(0, np.pi)), bool(rng.random() < 0.5)
        color = np.asarray(linear(any_color(rng))) * rng.uniform(0.5, 1.0)
        (x, y), (a, b), (red, green, blue) = centre.tolist(), half_axes.tolist(), color.tolist()
        patches.append(Patch((x, y), (a, b), angle, oval, (red, green, blue)))
    corner, right, below = corners
    start, along, down = ((float(r), float(g), float(b)) for r, g, b in (corner, right - corner, below - corner))
    return Backdrop(start, along, down, tuple(patches))


_TEXTURE, _ROOM, _BACKDROP = 101, 102, 103
_FINISHES = ("plastic", "wood", "steel_bright", "rubber", "concrete", "skin")
_SCALE = 0.03


@dataclass(frozen=True)
class Surfaces:
    """Surfaces of one split.

    Attributes:
        split: "train" or "test".
    """

    split: str

    def material(self, rng: np.random.Generator, scale: float = _SCALE) -> Material:
        """Draw a texture with a random offset.

        Args:
            rng: Random generator.
            scale: Approximate size of its features [m].

        Returns:
            The material.
        """
        texture = _texture(draw(rng, self.split, TEXTURES))
        x, y, z = (float(v) for v in rng.uniform(-1.0, 1.0, 3))
        return replace(texture, scale=texture.scale * scale / _SCALE, offset=(x, y, z))

    def room(self, rng: np.random.Generator) -> int:
        """Random number of a room; it determines the content of the room (`room_rng`)."""
        return draw(rng, self.split, ROOMS)

    def laboratory(self, rng: np.random.Generator, body_id: int) -> Surroundings:
        """Draw a furnished room.

        Args:
            rng: Random generator.
            body_id: Body id of all of its bodies.

        Returns:
            The room.
        """
        return _laboratory(self.room(rng), body_id)

    def backdrop(self, rng: np.random.Generator) -> np.random.Generator:
        """Random generator of a backdrop, determined by its number."""
        return np.random.default_rng([_BACKDROP, draw(rng, self.split, BACKDROPS)])


def room_rng(room: int) -> np.random.Generator:
    """Random generator of a room, determined by its number."""
    return np.random.default_rng([_ROOM, room])


@lru_cache(maxsize=ROOMS)
def _laboratory(room: int, body_id: int) -> Surroundings:
    return laboratory(room_rng(room), body_id)


@lru_cache(maxsize=TEXTURES)
def _texture(number: int) -> Material:
    """A plain or patterned texture by number."""
    rng = np.random.default_rng([_TEXTURE, number])
    if rng.random() < 0.4:
        name = str(rng.choice(_FINISHES))
        metallic = float(name.startswith("steel"))
        return finish(name, any_color(rng), float(rng.uniform(0.2, 0.9)), metallic, rng, axis=int(rng.integers(3)))
    pattern = list(Pattern)[rng.integers(len(Pattern))]
    return Material(
        linear(any_color(rng)),
        linear(any_color(rng)),
        pattern,
        float(_SCALE * np.exp(rng.normal(0.0, 0.7))),
        int(rng.integers(3)),
        float(rng.uniform(0.15, 0.95)),
        float(rng.random() < 0.12),
        float(rng.uniform(0.0, 0.5)),
    )
