"""Slotted and Phillips screwdrivers, common and long, and nut drivers: a shaft, a tip, and a handle of some profile."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import PchipInterpolator

from toolee_robot.end_effectors import Category
from toolee_robot.frames import transform
from toolee_robot.tools.materials import (
    PLASTIC,
    RUBBER,
    RUBBER_COLORED,
    STEEL_BRIGHT,
    STEEL_DARK,
    WOOD,
    Material,
    varied,
)
from toolee_robot.tools.model import EndEffector, Handle, Tool, ToolKind, assemble
from toolee_robot.tools.solids import (
    Convex,
    Piece,
    extrude,
    hexagon,
    lobes,
    loft,
    loft_piece,
    prism_points,
    regular_polygon,
    stack,
    superellipse,
)

TipShape = Callable[[np.random.Generator, float, float, Material], tuple[Piece, float]]
"""Generator of a tip: takes the random generator, the radius of the shaft [m], tool z of the end of the tip [m] and the
material; returns the tip and its length [m]."""
ShaftSize = Callable[[np.random.Generator], tuple[float, float]]
"""Draws radius and free length of a shaft [m]."""


def common_shaft(rng: np.random.Generator) -> tuple[float, float]:
    """Draw a shaft of 3 to 10 mm diameter and up to 250 mm length: 15 to 50 diameters, but at least 60 mm."""
    radius = rng.uniform(0.0015, 0.005)
    return radius, float(np.clip(rng.uniform(15, 50) * radius * 2, 0.060, 0.250))


def long_shaft(rng: np.random.Generator) -> tuple[float, float]:
    """Draw a shaft of 3 to 5 mm diameter and 150 to 300 mm length.

    The range that the trade sells as long or extra long, from 3 x 150 mm on.
    """
    return rng.uniform(0.0015, 0.0025), rng.uniform(0.150, 0.300)


def make_screwdriver(
    tip_shape: TipShape, shaft_size: ShaftSize, kind: ToolKind, seed: int, rng: np.random.Generator
) -> Tool:
    """Generate a screwdriver.

    Args:
        tip_shape: Generator of the tip.
        shaft_size: Draws the size of the shaft.
        kind: Kind of the screwdriver.
        seed: Seed that the tool is named after.
        rng: Random generator of the tool; equal states give equal tools.

    Returns:
        The screwdriver, `tool` frame [m].
    """
    radius, length = shaft_size(rng)
    handle_length = rng.uniform(0.080, 0.125)
    pieces, handle = _handle(rng, handle_length, radius)
    z_tip = handle.z_max + length
    shaft_material = varied(STEEL_BRIGHT if rng.uniform() < 0.75 else STEEL_DARK, rng)
    tip_material = varied(STEEL_DARK, rng) if rng.uniform() < 0.4 else shaft_material
    tip, tip_length = tip_shape(rng, radius, z_tip, tip_material)
    section = [superellipse(2.0, 24), regular_polygon(6, 24), superellipse(6.0, 24)][
        rng.choice(3, p=[0.75, 0.13, 0.12])
    ]
    z = np.array([handle.z_min + 0.25 * handle_length, z_tip - tip_length + 0.0005])
    shaft = loft_piece("shaft", stack(z, radius, None, section), shaft_material)
    bolster = _bolster(rng, handle, radius, shaft_material)
    ee = EndEffector(Category.SCREWDRIVER_HEAD, transform(None, [0.0, 0.0, z_tip]))
    return assemble(kind, seed, [*pieces, *bolster, shaft, tip], (ee,), handle)


def _handle(rng: np.random.Generator, length: float, shaft_radius: float) -> tuple[list[Piece], Handle]:
    """The handle, centred on the origin: a width profile times a section, optionally with a rubber sleeve."""
    radius = max(rng.uniform(0.0085, 0.0185), 2.2 * shaft_radius)
    profile = {
        "bulb": ([0.0, 0.03, 0.12, 0.35, 0.6, 0.8, 0.93, 1.0], [0.55, 0.82, 1.0, 1.0, 0.9, 0.66, 0.72, 0.62]),
        "straight": ([0.0, 0.04, 0.2, 0.8, 0.95, 1.0], [0.75, 0.98, 1.0, 1.0, 0.85, 0.6]),
        "waisted": ([0.0, 0.05, 0.2, 0.55, 0.72, 0.88, 1.0], [0.6, 0.95, 1.0, 0.88, 0.62, 0.85, 0.6]),
        "taper": ([0.0, 0.06, 0.3, 1.0], [0.7, 1.0, 1.0, 0.55]),
        "collar": (
            [0.0, 0.03, 0.1, 0.7, 0.74, 0.86, 0.92, 0.97, 1.0],
            [0.85, 1.0, 1.0, 1.0, 0.78, 0.8, 1.05, 1.02, 0.85],
        ),
        "ball": ([0.0, 0.03, 0.15, 0.4, 0.6, 0.85, 1.0], [0.4, 0.75, 1.1, 1.05, 0.75, 0.5, 0.45]),
    }
    knots, widths = profile[str(rng.choice(list(profile)))]
    u = np.unique(np.concatenate([np.linspace(0.0, 1.0, 20), [0.015, 0.985]]))
    widths_drawn = np.array(widths) * rng.uniform(0.93, 1.07, len(widths))
    scale = PchipInterpolator(knots, widths_drawn)(u)
    z = length * (u - 0.5)
    n = 48
    section = [
        superellipse(2.0, n),
        regular_polygon(6, n, rng.uniform(0.1, 0.5)),
        regular_polygon(3, n, rng.uniform(0.6, 0.8)),
        superellipse(rng.uniform(3.0, 5.0), n),
        lobes(int(rng.integers(5, 9)), rng.uniform(0.06, 0.16), n),
    ][rng.choice(5, p=[0.2, 0.25, 0.1, 0.15, 0.3])]
    section = section / np.linalg.norm(section, axis=1).max()
    # Blend flutes and flats into a circle towards both ends.
    fade = np.clip(np.minimum(u / 0.12, (1 - u) / 0.2), 0.0, 1.0)[:, None, None]
    sections = fade * section + (1 - fade) * superellipse(2.0, n)
    rings = stack(z, radius * scale, None, sections)
    base = varied(WOOD if rng.uniform() < 0.12 else PLASTIC, rng)
    pieces = [loft_piece("handle", rings, base, 0.1)]
    if base.name != "wood" and rng.uniform() < 0.4:
        # A soft sleeve over the middle of the handle, 0.5 mm thick.
        low, high = sorted(rng.choice(np.arange(2, len(z) - 3), 2, replace=False))
        high = max(high, low + 4)
        sleeve = stack(z[low:high], radius * scale[low:high] + 0.0005, None, sections[low:high])
        soft = varied(RUBBER if rng.uniform() < 0.5 else RUBBER_COLORED, rng)
        pieces.insert(0, Piece("grip", loft(sleeve), soft, ()))
    return pieces, Handle(z, np.ptp(rings[..., 0], axis=1) / 2, np.ptp(rings[..., 1], axis=1) / 2)


def _bolster(rng: np.random.Generator, handle: Handle, radius: float, material: Material) -> list[Piece]:
    if rng.uniform() > 0.3:
        return []
    z = handle.z_max + np.array([-0.004, rng.uniform(0.003, 0.008)])
    rings = stack(z, radius * rng.uniform(1.4, 1.9), None, regular_polygon(6, 24) if rng.uniform() < 0.6 else None)
    return [loft_piece("bolster", rings, material)]


def slotted_tip(rng: np.random.Generator, radius: float, z_tip: float, material: Material) -> tuple[Piece, float]:
    """Generate a flat blade: flared wider than the shaft, or ground down from it (cabinet tip).

    Args:
        rng: Random generator of the tool.
        radius: Radius of the shaft [m].
        z_tip: z of the end of the tip in the tool frame [m].
        material: Material of the tip.

    Returns:
        The tip and its length [m].
    """
    width = radius * (rng.uniform(1.05, 1.5) if rng.uniform() < 0.6 else rng.uniform(0.85, 1.0))
    thickness = rng.uniform(0.10, 0.22) * radius + 0.0001
    length = rng.uniform(3.5, 6.0) * radius
    z = z_tip - length * np.array([1.0, 0.75, 0.45, 0.2, 0.0])
    a = np.array([radius, radius, max(width, 0.9 * radius), width, width * rng.uniform(0.85, 1.0)])
    b = np.array([radius, 0.95 * radius, 0.5 * radius, 1.6 * thickness, thickness])
    circle, square = superellipse(2.0, 24), superellipse(10.0, 24)
    rings = stack(z, a, b, np.stack([circle, 0.6 * circle + 0.4 * square, square, square, square]))
    return loft_piece("tip", rings, material, 0.3), length


def phillips_tip(rng: np.random.Generator, radius: float, z_tip: float, material: Material) -> tuple[Piece, float]:
    """Generate a blunted cone with four flutes at right angles that run out on the shaft.

    Args:
        rng: Random generator of the tool.
        radius: Radius of the shaft [m].
        z_tip: z of the end of the tip in the tool frame [m].
        material: Material of the tip.

    Returns:
        The tip and its length [m].
    """
    blunt = rng.uniform(0.2, 0.32) * radius
    cone = (radius - blunt) / np.tan(np.deg2rad(rng.uniform(24.0, 28.0)))
    length = cone * rng.uniform(1.7, 2.3)
    z = z_tip - np.array([length + 0.001, cone, 0.15 * blunt, 0.0])
    rings = stack(z, np.array([radius, radius, blunt, 0.8 * blunt]))
    solid = loft(rings)
    # Section of a flute: a quadrant whose corner moves outwards from the wing thickness to the surface of the shaft.
    tip_corner, end_corner = rng.uniform(0.09, 0.14) * radius, 0.75 * radius
    quadrant = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]) * radius
    beyond = 0.001
    slope = (tip_corner - end_corner) / length
    for k in range(4):
        c, s = np.cos(k * np.pi / 2), np.sin(k * np.pi / 2)
        turn = np.array([[c, s], [-s, c]])
        flute = [
            np.column_stack([(quadrant + corner) @ turn, np.full(4, height)])
            for corner, height in ((end_corner, z_tip - length), (tip_corner + slope * beyond, z_tip + beyond))
        ]
        solid = solid - loft(np.stack(flute))
    return Piece("tip", solid, material, (Convex(rings, 0.04),)), length


def nut_tip(rng: np.random.Generator, radius: float, z_tip: float, material: Material) -> tuple[Piece, float]:
    """Generate a cup with a hexagonal hole.

    Args:
        rng: Random generator of the tool.
        radius: Radius of the shaft [m].
        z_tip: z of the mouth in the tool frame [m]; the EE's origin is the centre of the hole there.
        material: Material of the tip.

    Returns:
        The tip and its length [m].
    """
    hole = hexagon(rng.uniform(0.007, 0.015))
    outer = max(hole[0, 0] * rng.uniform(1.12, 1.3), radius + 0.0005)
    length = rng.uniform(0.014, 0.036)
    shoulder = length - rng.uniform(0.001, 0.006)
    z = z_tip - np.array([length, shoulder, 0.0006, 0.0])
    rings = stack(z, np.array([radius, outer, outer, outer - 0.0006]), None, superellipse(2.0, 32))
    depth = rng.uniform(0.6, 0.9) * shoulder
    solid = loft(rings) - extrude(hole, z_tip - depth, z_tip + 0.001)
    circle = superellipse(2.0, 24)
    return Piece("tip", solid, material, (Convex(prism_points(outer * circle, z_tip - length, z_tip)),)), length
