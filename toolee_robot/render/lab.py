"""Random laboratory around a robot on a table: floor, walls, table top, furniture, lamps.

The world frame is the base of the robot: z up, table top at z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import transform
from toolee_robot.render.material import Material, Pattern
from toolee_robot.render.mesh import box, cylinder, plane
from toolee_robot.render.palette import any_color, finish, linear
from toolee_robot.render.scene import Body, Environment, Light, Lobe


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
