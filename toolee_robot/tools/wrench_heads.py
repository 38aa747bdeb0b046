"""Open, ring and adjustable wrench heads.

Head axes: x out of the mouth of the jaw, y across the flats, z along the axis of the nut; origin at the centre of the
nut.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import manifold3d
import numpy as np

from toolee_robot.frames import Array, transform
from toolee_robot.tools.materials import STEEL_BRIGHT, Material, varied
from toolee_robot.tools.solids import (
    Convex,
    Piece,
    cross_section,
    extrude,
    hexagon,
    loft,
    place,
    prism_points,
    stack,
    superellipse,
)


@dataclass(frozen=True, eq=False)
class WrenchHead:
    """A wrench head in head axes.

    Attributes:
        pieces: Solids of the head [m].
        ee_x: x of the EE origin [m].
        pivot_x: x of the pivot [m], the point that lies on the axis of the handle at every head angle.
        join: Distance [m] from the pivot back to the end of the handle.
        radius: Half of the width of the head [m].
        half_thickness: Half of the thickness along z [m].
    """

    pieces: list[Piece]
    ee_x: float
    pivot_x: float
    join: float
    radius: float
    half_thickness: float


def open_head(rng: np.random.Generator, size: float, material: Material) -> WrenchHead:
    """A round head with a slot between parallel flats.

    The throat is flat, a V of 120 degrees, or round; the mouth is cut square or oblique, so that one flat may be
    shorter.

    Args:
        rng: Random generator of the tool.
        size: Width across flats [m].
        material: Material of the head.

    Returns:
        The head, in head axes.
    """
    half = 0.5 * size
    wall = half * rng.uniform(0.7, 1.2)
    radius = half + wall
    stretch = rng.uniform(0.95, 1.2)
    throat = half * rng.uniform(0.9, 1.3)
    tilt = np.tan(np.deg2rad(rng.uniform(-18.0, 18.0)))
    reach = half * rng.uniform(0.95, 1.35)
    far = 3 * radius
    t = 2 * np.pi * np.arange(64) / 64
    outline = cross_section(np.column_stack([radius * stretch * np.cos(t), radius * np.sin(t)]))
    outline = outline ^ cross_section(
        [[-far, -far], [reach - tilt * far, -far], [reach + tilt * far, far], [-far, far]]
    )
    shape = str(rng.choice(["flat", "v", "round"]))
    if shape == "round":
        arc = np.linspace(-np.pi / 2, np.pi / 2, 13)
        inner = np.column_stack([-throat + 0.6 * half * (1 - np.cos(arc)), half * np.sin(arc)])
    elif shape == "v":
        inner = np.array(
            [[-throat + half * np.tan(np.pi / 6), -half], [-throat, 0.0], [-throat + half * np.tan(np.pi / 6), half]]
        )
    else:
        inner = np.array([[-throat, -half], [-throat, half]])
    slot = cross_section(np.concatenate([inner, [[far, half], [far, -half]]]))
    half_thickness = float(np.clip(size * rng.uniform(0.16, 0.26), 0.002, 0.007))
    on_ellipse = radius * stretch * np.sqrt(1 - (half / radius) ** 2)
    shorter = min(reach - abs(tilt) * half, on_ellipse)
    boxes = (
        [[-throat, half], [far, half], [far, far], [-throat, far]],
        [[-throat, -half], [far, -half], [far, -far], [-throat, -far]],
        [[-far, -far], [-throat, -far], [-throat, far], [-far, far]],
    )
    convex = tuple(
        Convex(prism_points(_corners(outline ^ cross_section(box)), -half_thickness, half_thickness)) for box in boxes
    )
    # What a round or V throat leaves in the slot's corners.
    convex += tuple(
        Convex(prism_points([[-throat, 0.0], [-throat, y], [inner[0, 0], y]], -half_thickness, half_thickness))
        for y in (-half, half)
        if shape != "flat"
    )
    piece = Piece("jaw", extrude(outline - slot, -half_thickness, half_thickness), material, convex)
    join = max(0.5 * (throat + radius * stretch), 0.8 * radius * stretch)
    return WrenchHead([piece], 0.5 * (shorter - throat), 0.0, join, radius, half_thickness)


def _corners(region: Any) -> Array:
    return np.concatenate([np.asarray(polygon) for polygon in region.to_polygons()])


def ring_head(rng: np.random.Generator, size: float, material: Material) -> WrenchHead:
    """Generate a ring with a hexagonal or twelve-point hole; its EE's origin is the nut's centre.

    Args:
        rng: Random generator of the tool.
        size: Width across flats [m].
        material: Material of the head.

    Returns:
        The head, in head axes.
    """
    hexagonal = hexagon(size)
    corner = float(hexagonal[0, 0])
    radius = corner * rng.uniform(1.22, 1.5)
    half_thickness = float(np.clip(size * rng.uniform(0.2, 0.36), 0.003, 0.009))
    bevel = 0.25 * (radius - corner)
    z = half_thickness * np.array([-1.0, -0.75, 0.75, 1.0])
    rings = stack(z, np.array([radius - bevel, radius, radius, radius - bevel]), None, superellipse(2.0, 48))
    hole = cross_section(hexagonal)
    if rng.uniform() < 0.65:
        hole = hole + hole.rotate(30.0)
    solid = loft(rings) - extrude(hole, -2 * half_thickness, 2 * half_thickness)
    t = np.linspace(0, 2 * np.pi, 13)
    wedges = [
        [[r * np.cos(a), r * np.sin(a)] for r in (0.93 * corner, radius) for a in (t[i], t[i + 1])] for i in range(12)
    ]
    convex = tuple(Convex(prism_points(wedge, -half_thickness, half_thickness)) for wedge in wedges)
    return WrenchHead(
        [Piece("ring", solid, material, convex)], 0.0, 0.0, 0.5 * (corner + radius), radius, half_thickness
    )


def adjustable_head(rng: np.random.Generator, material: Material, scale: float) -> WrenchHead:
    """An adjustable head at a random opening: fixed jaw with body, sliding jaw on its rail, and worm.

    Args:
        rng: Random generator of the tool.
        material: Material of the jaws.
        scale: Size factor; 1 has a capacity of 30 mm.

    Returns:
        The head, in head axes.
    """
    capacity = 0.030 * scale
    opening = max(rng.uniform(0.15, 1.0) * capacity, 0.004)
    half, throat = 0.5 * opening, 0.5 * capacity * rng.uniform(0.75, 1.0)
    tip = throat * rng.uniform(0.8, 1.1)
    wall = capacity * rng.uniform(0.42, 0.6)
    half_thickness = float(np.clip(0.0065 * scale * rng.uniform(0.85, 1.2), 0.0035, 0.0085))
    neck = capacity * rng.uniform(0.34, 0.42)
    pivot = -throat - capacity * rng.uniform(0.85, 1.15)
    # The rail, at x = -throat, covers the travel of the sliding jaw.
    rail = capacity - half + rng.uniform(0.2, 0.5) * wall
    low = -half - wall
    blob = [
        *_circle(tip - 0.28 * wall, -half - 0.28 * wall, 0.28 * wall),
        *_circle(-0.4 * throat, low + 0.5 * wall, 0.5 * wall),
        *_circle(pivot, 0.0, neck),
        [-throat, rail],
        [-throat - 0.22 * capacity, rail],
        [-throat, low],
    ]
    if rng.uniform() < 0.6:
        blob += _circle(-rng.uniform(0.4, 0.8) * throat, 0.0, half + wall)
    body = manifold3d.CrossSection.hull_points(np.asarray(blob))
    body = body ^ cross_section([[-1.0, -1.0], [tip, -1.0], [tip, 1.0], [-1.0, 1.0]])
    mouth = [[-throat, -half], [1.0, -half], [1.0, 1.0], [-throat, 1.0]]
    worm_radius = 0.15 * capacity
    worm_x = -throat - 0.45 * capacity
    box = np.array([[-1.25, -1.9], [1.25, -1.9], [1.25, 1.5], [-1.25, 1.5]]) * worm_radius + [worm_x, 0.0]
    plate = extrude(body - cross_section(mouth) - cross_section(box), -half_thickness, half_thickness)
    lip = rng.uniform(0.0, 0.12) * throat
    end = min(half + wall * rng.uniform(0.75, 1.0), rail + 0.6 * wall)
    jaw = np.array([
        [tip - lip, half], [tip - lip, half + 0.35 * (end - half)], [0.3 * tip, half + 0.85 * (end - half)],
        [-0.5 * throat, end], [-throat + 0.0002, end], [-throat + 0.0002, half],
    ])  # fmt: skip
    thin = half_thickness * rng.uniform(0.8, 0.97)
    # The rack of the sliding jaw runs inside the body, down to the worm.
    rack = np.array([
        [-throat - 0.2 * capacity, half], [-throat + 0.001, half],
        [-throat + 0.001, min(end, rail)], [-throat - 0.2 * capacity, min(end, rail)],
    ])  # fmt: skip
    sliding = extrude(jaw, -thin, thin) + extrude(rack, -0.5 * thin, 0.5 * thin)
    n = 15
    ridges = [0.4, 0.4, *(1.0 - 0.16 * (np.arange(n) % 2)), 0.4, 0.4]
    along = [-2.4, -1.85, *np.linspace(-1.84, 1.44, n), 1.45, 2.0]
    rings = stack(np.array(along) * worm_radius, np.array(ridges) * worm_radius, None, superellipse(2.0, 16))
    lay = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), [worm_x, 0.0, 0.0])
    fixed_jaw = _corners(body ^ cross_section([[-1.0, -1.0], [1.0, -1.0], [1.0, -half], [-1.0, -half]]))
    under = _corners(body ^ cross_section([[-1.0, -1.0], [-throat, -1.0], [-throat, 1.0], [-1.0, 1.0]]))
    pieces = [
        Piece("jaw", plate, material, tuple(
            Convex(prism_points(p, -half_thickness, half_thickness)) for p in (fixed_jaw, under)
        )),
        Piece("worm", place(loft(rings), lay), varied(STEEL_BRIGHT, rng), ()),
        Piece("sliding_jaw", sliding, material, (Convex(prism_points(jaw, -thin, thin)),)),
    ]  # fmt: skip
    ee_x = 0.5 * (tip - lip - throat)
    return WrenchHead(pieces, ee_x, pivot, -0.6 * neck, 1.15 * neck, half_thickness)


def _circle(x: float, y: float, radius: float) -> list[list[float]]:
    t = 2 * np.pi * np.arange(32) / 32
    return [[x + radius * np.cos(a), y + radius * np.sin(a)] for a in t]
