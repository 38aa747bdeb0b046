"""What lights a scene: a measured panorama around it, or lamps of a finite area under a ceiling."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.render.path_tracing.library import mitsuba
from toolee_robot.render.path_tracing.surroundings import Surroundings

LAMP = "lamp"
"""How the ids of lamps begin."""
_CEILING = (1.6, 2.6)
"""Range of a lamp's height above the camera where there is no ceiling [m]."""
_REACH = 0.9
"""Largest horizontal distance of the first lamp from the camera [m]; rooms are at least 1 m wide on each side."""


def panorama(surroundings: Surroundings, rng: np.random.Generator) -> dict[str, Any]:
    """Draw surroundings at infinity, turned about the vertical; without panoramas, the sky of Mitsuba's model.

    Args:
        surroundings: Panoramas to choose from.
        rng: Random generator.

    Returns:
        Mitsuba's emitters by id.
    """
    mi = mitsuba()
    turned = mi.ScalarTransform4f().rotate([0, 0, 1], float(rng.uniform(0.0, 360.0)))
    if not surroundings.panoramas:
        sun = rng.normal(size=3)
        sun[2] = abs(sun[2]) + 0.3
        sky = {"turbidity": float(rng.uniform(2.0, 8.0)), "sun_direction": (sun / np.linalg.norm(sun)).tolist()}
        return {"around": {"type": "sunsky", **sky, "albedo": 0.3, "sun_scale": 0.02, "to_world": turned}}
    image = surroundings.panoramas[int(rng.integers(len(surroundings.panoramas)))]
    upright = turned @ mi.ScalarTransform4f().rotate([1, 0, 0], 90.0)  # y is up in a panorama, z in the scene
    return {"around": {"type": "envmap", "bitmap": mi.Bitmap(image), "to_world": upright}}


def lamps(camera: Array, ceiling: float | None, rng: np.random.Generator) -> dict[str, Any]:
    """Draw one to three lamps that shine downwards and, where there is no ceiling, faint light from all around.

    Args:
        camera: Position of the camera, world frame, (3,) [m].
        ceiling: Height of the ceiling, world frame [m]; None where there is none.
        rng: Random generator.

    Returns:
        Mitsuba's emitters by id.
    """
    mi = mitsuba()
    emitters: dict[str, Any] = {}
    if ceiling is None:
        faint = float(rng.uniform(0.02, 0.15))
        emitters["around"] = {"type": "constant", "radiance": {"type": "rgb", "value": [faint] * 3}}
    for k in range(int(rng.integers(1, 4))):
        height = camera[2] + rng.uniform(*_CEILING) if ceiling is None else ceiling - 0.02
        reach, angle = rng.uniform(0.0, _REACH if k == 0 else 2.5), rng.uniform(0.0, 2.0 * np.pi)
        place = [camera[0] + reach * np.cos(angle), camera[1] + reach * np.sin(angle), height]
        long, wide = rng.uniform(0.4, 1.4), rng.uniform(0.15, 0.6)
        T = mi.ScalarTransform4f().translate([float(v) for v in place])
        T = T @ mi.ScalarTransform4f().rotate([0, 0, 1], float(rng.uniform(0.0, 180.0)))
        T = T @ mi.ScalarTransform4f().rotate([1, 0, 0], 180.0)  # a rectangle shines along its z
        T = T @ mi.ScalarTransform4f().scale([float(long / 2), float(wide / 2), 1.0])
        power, kelvin = rng.uniform(0.5, 1.5), float(rng.uniform(2700.0, 6500.0))
        radiance = 4.0 * power / (long * wide) * np.array(_blackbody(kelvin))
        light = {"type": "area", "radiance": {"type": "rgb", "value": radiance.tolist()}}
        emitters[f"{LAMP}{k}"] = {"type": "rectangle", "to_world": T, "emitter": light}
    return emitters


def _blackbody(kelvin: float) -> tuple[float, float, float]:
    """Linear sRGB of a black body, green 1: between 2700 and 6500 K, by interpolation."""
    points = (2700.0, 3500.0, 4500.0, 5500.0, 6500.0)
    red = np.interp(kelvin, points, (2.05, 1.58, 1.27, 1.10, 1.0))
    blue = np.interp(kelvin, points, (0.25, 0.45, 0.68, 0.87, 1.0))
    return float(red), 1.0, float(blue)
