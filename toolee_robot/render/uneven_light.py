"""Random light of a high range, as rooms have: a window in a dark room, a lamp on the bench, small spots."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.render.palette import Color
from toolee_robot.render.scene import Environment, Light, Lobe


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
