"""Random surroundings of a scene: a laboratory, its lamps and ambient light, evenly or unevenly lit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.render.material import (
    Body,
    Color,
    Environment,
    Light,
    Lobe,
    Material,
    Pattern,
    any_color,
    finish,
    linear,
)
from toolee_robot.render.mesh import box, cylinder, plane


@dataclass(frozen=True, eq=False)
class Surroundings:
    """A room.

    Attributes:
        bodies: Static bodies, all with one body id.
        lights: Lamps.
        environment: Ambient light.
    """

    bodies: tuple[Body, ...]
    lights: tuple[Light, ...]
    environment: Environment

    def raised(self, height: float) -> Surroundings:
        """Move the bodies up.

        Args:
            height: By how much [m].

        Returns:
            The room there.
        """
        up = transform(p=(0.0, 0.0, height))
        return replace(self, bodies=tuple(replace(body, X_world_body=up @ body.X_world_body) for body in self.bodies))


def laboratory(rng: np.random.Generator, body_id: int) -> Surroundings:
    """Generate a random room with grey floor, light walls, a table and furniture.

    Args:
        rng: Random generator.
        body_id: Body id of all of its bodies.

    Returns:
        The room.
    """
    bodies = [_wall_or_floor(np.eye(3), (0.0, 0.0, -0.8), _floor(rng), body_id)]
    wall = _wall(rng)
    for yaw in np.arange(4) * np.pi / 2:
        distance = rng.uniform(1.9, 3.2)
        R = Rotation.from_euler("z", yaw).as_matrix() @ Rotation.from_euler("y", -np.pi / 2).as_matrix()
        outward = Rotation.from_euler("z", yaw).apply([1.0, 0.0, 0.0])
        bodies.append(_wall_or_floor(R, distance * outward, wall, body_id))
        for _ in range(rng.integers(2, 6)):
            bodies.append(_furniture(rng, yaw, distance, body_id))
    top = Material(
        linear((0.75, 0.73, 0.70)),
        linear((0.62, 0.60, 0.58)),
        Pattern.CLOUD,
        0.15,
        roughness=float(rng.uniform(0.3, 0.7)),
    )
    if rng.random() < 0.4:
        top = finish("wood", (0.70, 0.56, 0.40), 0.5, 0.0, rng, axis=0)
    bodies.append(Body(box((1.5, 1.3, 0.04)), transform(None, (0.45, 0.0, -0.02)), top, body_id))
    for x, y in ((-0.25, -0.6), (1.15, -0.6), (-0.25, 0.6), (1.15, 0.6)):
        leg = Material(linear((0.3, 0.3, 0.32)), roughness=0.4, metallic=0.6)
        bodies.append(Body(box((0.05, 0.05, 0.76)), transform(None, (x, y, -0.42)), leg, body_id))
    return Surroundings(tuple(bodies), lamps(rng), environment(rng))


def lamps(rng: np.random.Generator) -> tuple[Light, ...]:
    """One to three random distant lamps (ceiling or window)."""
    lights = []
    share = rng.dirichlet(np.full(3, 1.5))[: rng.integers(1, 4)]
    strengths = np.sort(share / share.sum() * rng.uniform(0.45, 1.0))[::-1]
    for k, strength in enumerate(strengths):
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2]) + 0.6
        direction /= np.linalg.norm(direction)
        warmth = rng.normal(0.0, 0.08)
        color = strength * np.array([1.0 + warmth, 1.0, 1.0 - warmth])
        lights.append(
            Light(
                (float(color[0]), float(color[1]), float(color[2])),
                direction=(float(direction[0]), float(direction[1]), float(direction[2])),
                softness=float(rng.uniform(0.02, 0.15)),
                shadow=k < 2,  # the shadow of the weakest lamp is too faint to be worth its cost
            )
        )
    return tuple(lights)


def environment(rng: np.random.Generator) -> Environment:
    """Random ambient light of a room, with windows and lamps that metal reflects."""
    level = rng.uniform(0.25, 0.6)
    lobes = []
    for _ in range(rng.integers(2, 6)):
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2]) * 0.8 + 0.1
        direction /= np.linalg.norm(direction)
        value = float(rng.uniform(0.8, 4.0))
        lobes.append(
            Lobe(
                (float(direction[0]), float(direction[1]), float(direction[2])),
                float(rng.uniform(0.1, 0.4)),
                (value,) * 3,
            )
        )

    def grey(low: float, high: float) -> tuple[float, float, float]:
        c = level * rng.uniform(low, high) * np.exp(rng.normal(0.0, 0.05, 3))
        return float(c[0]), float(c[1]), float(c[2])

    return Environment(grey(0.9, 1.3), grey(0.6, 1.1), grey(0.2, 0.6), tuple(lobes))


def _wall_or_floor(R: object, p: object, material: Material, body_id: int) -> Body:
    return Body(plane(12.0), transform(R, p), material, body_id)


def _floor(rng: np.random.Generator) -> Material:
    grey = float(rng.uniform(0.35, 0.6))
    return finish("concrete", (grey, grey, 1.02 * grey), 0.6, 0.0, rng)


def _wall(rng: np.random.Generator) -> Material:
    value = float(rng.uniform(0.6, 0.9))
    tint = rng.normal(0.0, 0.02, 3)
    color = linear((value + float(tint[0]), value + float(tint[1]), value + float(tint[2])))
    second = (0.85 * color[0], 0.85 * color[1], 0.85 * color[2])
    return Material(color, second, Pattern.CLOUD, 0.6, roughness=0.8)


def _furniture(rng: np.random.Generator, yaw: float, wall_distance: float, body_id: int) -> Body:
    """A cabinet, board, shelf or bin in front of a wall."""
    size = rng.uniform((0.05, 0.15, 0.15), (0.5, 1.2, 1.4))
    side = rng.uniform(-1.6, 1.6)
    height = rng.uniform(-0.5, 1.2) if rng.random() < 0.6 else size[2] / 2 - 0.8
    p = Rotation.from_euler("z", yaw).apply([wall_distance - size[0] / 2, side, height])
    name = str(rng.choice(["plastic", "steel_painted", "wood", "concrete"]))
    material = finish(name, any_color(rng), float(rng.uniform(0.3, 0.8)), 0.0, rng)
    X = transform(Rotation.from_euler("z", yaw), p)
    mesh = cylinder(float(size[1]) / 3, float(size[2])) if rng.random() < 0.15 else box(size)
    return Body(mesh, X, material, body_id)


def uneven_light(rng: np.random.Generator) -> tuple[tuple[Light, ...], Environment]:
    """Draw lamps and ambient light of a high range: from one side, or from small lamps all over.

    Args:
        rng: Random generator.

    Returns:
        The lamps and the ambient light.
    """
    kind = rng.random()
    if kind < 0.35:
        return _window(rng)
    if kind < 0.6:
        return _bench_lamp(rng)
    return _spots(rng)


def _window(rng: np.random.Generator) -> tuple[tuple[Light, ...], Environment]:
    """A window, or the sun through it, at one side of a dark room."""
    side = _direction(rng, 0.05, 0.6)
    tint = _tint(rng, -0.5, 0.25)
    strength = float(rng.uniform(0.6, 1.8))
    light = Light(_scaled(tint, strength), direction=side, softness=float(rng.uniform(0.01, 0.3)))
    pane = Lobe(side, float(rng.uniform(0.1, 0.35)), _scaled(tint, float(rng.uniform(4.0, 25.0))))
    glow = Lobe(side, float(rng.uniform(0.7, 1.2)), _scaled(tint, float(rng.uniform(0.1, 0.6))))
    return (light,), _room(rng, 0.02, 0.2, (pane, glow, *_small_lobes(rng, 0, 3)))


def _bench_lamp(rng: np.random.Generator) -> tuple[tuple[Light, ...], Environment]:
    """One or two near lamps above or beside the camera's view, in a dark room."""
    lights = []
    for k in range(1 if rng.random() < 0.6 else 2):
        way = np.array(_direction(rng, -0.1, 1.2)) * rng.uniform(0.35, 1.3)
        power = float(rng.uniform(0.25, 1.0) / (1 + k))
        color = _scaled(_tint(rng, -0.3, 1.0), power)
        place = (float(way[0]), float(way[1]), float(way[2]))
        lights.append(Light(color, position=place, softness=float(rng.uniform(0.01, 0.1))))
    return tuple(lights), _room(rng, 0.03, 0.2, _small_lobes(rng, 1, 4))


def _spots(rng: np.random.Generator) -> tuple[tuple[Light, ...], Environment]:
    """Small bright lamps all over the ceiling or the walls, which metal shows as points."""
    lobes = _small_lobes(rng, 4, 14)
    lights = []
    for k, lobe in enumerate(lobes[: int(rng.integers(1, 4))]):
        color = _scaled(lobe.color, float(rng.uniform(0.2, 0.9)) / max(lobe.color) / (1 + 0.5 * k))
        softness = float(rng.uniform(0.01, 0.08))
        lights.append(Light(color, direction=lobe.direction, softness=softness, shadow=k < 2))
    return tuple(lights), _room(rng, 0.05, 0.45, lobes)


def _small_lobes(rng: np.random.Generator, least: int, most: int) -> tuple[Lobe, ...]:
    tint = _tint(rng, -0.4, 0.9)
    count = int(rng.integers(least, most + 1))
    return tuple(
        Lobe(_direction(rng, -0.1, 2.0), float(rng.uniform(0.05, 0.14)), _scaled(tint, float(rng.uniform(5.0, 40.0))))
        for _ in range(count)
    )


def _room(rng: np.random.Generator, low: float, high: float, lobes: tuple[Lobe, ...]) -> Environment:
    level = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    tint = _tint(rng, -0.3, 0.5)
    zenith, horizon, ground = (_scaled(tint, level * float(f)) for f in rng.uniform([0.5, 0.5, 0.2], [1.4, 1.2, 0.8]))
    return Environment(zenith, horizon, ground, lobes)


def _direction(rng: np.random.Generator, low: float, high: float) -> Color:
    """Random unit vector whose slope above the horizon is in a range."""
    angle, slope = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(low, high)
    d: Array = np.array([np.cos(angle), np.sin(angle), slope]) / np.hypot(1.0, slope)
    return float(d[0]), float(d[1]), float(d[2])


def _tint(rng: np.random.Generator, cold: float, warm: float) -> Color:
    """Colour of light, green 1: -0.5 as from a blue sky, 0 white, 1 as from a bulb; fluorescent lamps add green."""
    w = rng.uniform(cold, warm)
    green = 0.12 * rng.random() if rng.random() < 0.2 else 0.0
    return float(1.0 + 0.4 * w - green), 1.0, float(1.0 - 0.45 * w - green)


def _scaled(color: Color, factor: float) -> Color:
    return color[0] * factor, color[1] * factor, color[2] * factor
