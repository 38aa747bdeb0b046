"""Pipe wrenches and monkey wrenches: jaws at right angles to the handle, the mouth at tool x.

Outlines lie in the plane of the handle, (x, z) of the `tool` frame, and are extruded along tool y.
"""

from __future__ import annotations

from typing import Any

import manifold3d
import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.tools.materials import (
    ALUMINIUM,
    STEEL_BRIGHT,
    STEEL_DARK,
    STEEL_PAINTED,
    WOOD,
    Material,
    varied,
)
from toolee_robot.tools.model import EndEffector, Handle, Tool, ToolKind, assemble
from toolee_robot.tools.solids import (
    Convex,
    Piece,
    cross_section,
    extrude,
    lobes,
    loft,
    loft_piece,
    move,
    place,
    prism_points,
    stack,
    superellipse,
)

_UPRIGHT = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
"""Takes an extrusion of an outline (x, z) to the tool frame."""


def make_pipe_wrench(kind: ToolKind, seed: int, rng: np.random.Generator) -> Tool:
    """Generate a pipe wrench (Stillson pattern): a hook jaw that runs through a housing and a knurled nut.

    Lengths of 200 to 360 mm for pipes of up to 25 to 50 mm, the 8 to 14 inch sizes of makers' catalogues (1, 1 1/2 and
    2 inch pipes for 8, 10 and 14 inches); the other proportions are estimated.

    Args:
        kind: Kind of the wrench.
        seed: Seed that the tool is named after.
        rng: Random generator of the tool; equal states give equal tools.

    Returns:
        The wrench, `tool` frame [m].
    """
    length = rng.uniform(0.20, 0.36)
    c = length * rng.uniform(0.125, 0.147)  # capacity; all proportions are shares of it
    opening = c * rng.uniform(0.15, 1.0)
    t = c * rng.uniform(0.19, 0.25)
    bar, shank, depth = c * rng.uniform(0.26, 0.33), c * rng.uniform(0.38, 0.48), c * rng.uniform(0.85, 1.1)
    jaw = varied(STEEL_BRIGHT if rng.uniform() < 0.35 else STEEL_DARK, rng)
    body = varied((STEEL_PAINTED, STEEL_DARK, ALUMINIUM)[rng.choice(3, p=[0.6, 0.25, 0.15])], rng)
    half_length = 0.5 * (length - 3.1 * c)
    heel = half_length + 1.75 * c  # z of the heel jaw's teeth
    hook = heel + opening
    throat = -bar * rng.uniform(0.8, 1.0)
    back = throat - shank - 0.1 * c
    tips = throat + depth * rng.uniform(0.9, 1.0), throat + depth * rng.uniform(0.95, 1.1)
    pitch = rng.uniform(0.0022, 0.0034)

    heel_jaw = np.array([
        [throat + 0.04 * c, heel], [tips[0], heel], [tips[0] - 0.02 * c, heel - 0.32 * c], [bar, heel - 0.8 * c],
        [throat + 0.04 * c, heel - 0.8 * c],
    ])  # fmt: skip
    bulge = rng.uniform(0.56, 0.7) * c
    arm = _corners(manifold3d.CrossSection.hull_points(np.array([
        [throat - shank, hook], [tips[1], hook], [tips[1] + 0.05 * c, hook + rng.uniform(0.2, 0.34) * c],
        *_circle(throat - 0.4 * shank, hook + 0.6 * bulge, 0.4 * bulge),
        *_circle(throat + 0.45 * depth, hook + 0.55 * bulge, 0.35 * bulge),
    ])))  # fmt: skip
    arm = arm[arm[:, 1] > hook - 1e-6]
    stem = _box(throat - shank, throat, heel - 0.3 * c, hook + 0.2 * c)
    collar = np.array([
        [back, heel - 0.22 * c], [throat + 0.08 * c, heel - 0.22 * c], [bar, heel - 0.7 * c], [bar, heel - 1.9 * c],
        [-bar, heel - 1.9 * c], [back, heel - 1.5 * c],
    ])  # fmt: skip
    window = _box(back - 0.1, throat - 0.1 * shank, heel - 1.2 * c, heel - rng.uniform(0.55, 0.65) * c)
    housing = Piece(
        "housing", _plate(cross_section(collar) - cross_section(window), 1.18 * t), body,
        (_prism(collar, 1.18 * t),),
    )  # fmt: skip

    nut_radius, nut_top = 0.5 * shank * rng.uniform(1.25, 1.5), float(window[2, 1]) - 0.02 * c
    knurl = lobes(int(rng.integers(16, 28)), 0.1, 96)
    low = heel - 1.19 * c
    rounded = np.array([0.93, 1.0, 1.0, 0.93])
    edge = 0.06 * c
    nut = stack(np.array([low, low + edge, nut_top - edge, nut_top]), nut_radius * rounded, None, knurl)
    nut[..., 0] += throat - 0.5 * shank
    # The threaded end of the hook's shank moves with the hook; closed, it comes out below the housing.
    ridges = np.linspace(hook - 2.35 * c, heel - 0.2 * c, 41)
    thread = stack(ridges, 0.44 * shank * (1.0 - 0.1 * (np.arange(41) % 2)), None, superellipse(2.0, 16))
    thread[..., 0] += throat - 0.5 * shank

    handle, bar_piece = _bar(rng, half_length, heel - 0.9 * c, bar, 0.9 * t, body)
    pieces = [
        bar_piece,
        housing,
        Piece("jaw", _plate(_toothed(heel_jaw, heel, 1.0, pitch), t), jaw, (_prism(heel_jaw, t),)),
        Piece("hook", _plate(_toothed(arm, hook, -1.0, pitch) + cross_section(stem), t), jaw,
              (_prism(arm, t), _prism(stem, t))),
        loft_piece("thread", thread, jaw, 0.3),
        loft_piece("nut", nut, varied(STEEL_DARK if rng.uniform() < 0.6 else STEEL_BRIGHT, rng), 0.2),
    ]  # fmt: skip
    return assemble(kind, seed, pieces, (_ee(0.5 * (throat + min(tips)), heel + 0.5 * opening, handle),), handle)


def make_monkey_wrench(kind: ToolKind, seed: int, rng: np.random.Generator) -> Tool:
    """Generate a monkey wrench: smooth jaws, of which the lower one slides on a bar and is moved by a knurled screw.

    Lengths of 180 to 380 mm, the 7 to 15 inch sizes of old ones; it opens to about a fifth of that (estimated).

    Args:
        kind: Kind of the wrench.
        seed: Seed that the tool is named after.
        rng: Random generator of the tool; equal states give equal tools.

    Returns:
        The wrench, `tool` frame [m].
    """
    length = rng.uniform(0.18, 0.38)
    depth = length * rng.uniform(0.12, 0.165)
    widest = depth * rng.uniform(1.2, 1.5)
    opening = widest * rng.uniform(0.12, 1.0)
    half_x, half_y = length * rng.uniform(0.034, 0.044), length * rng.uniform(0.018, 0.023)
    t = length * rng.uniform(0.030, 0.038)
    h, head = length * rng.uniform(0.08, 0.11), length * rng.uniform(0.085, 0.115)
    steel = varied((STEEL_BRIGHT, STEEL_DARK, STEEL_PAINTED)[rng.choice(3, p=[0.35, 0.45, 0.2])], rng)
    half_length = 0.5 * length * rng.uniform(0.46, 0.54)
    screw = length * rng.uniform(0.11, 0.14)
    upper = half_length + screw + h + widest  # z of the fixed jaw
    lower = upper - opening
    tips = half_x + depth, half_x + depth * rng.uniform(0.93, 1.0)
    back = -half_x - length * rng.uniform(0.008, 0.03)

    fixed = np.array([
        [-half_x, upper], [tips[0], upper], [tips[0], upper + 0.35 * head],
        [half_x + rng.uniform(0.1, 0.6) * depth, upper + head], [back, upper + head], [back, upper + 0.25 * head],
    ])  # fmt: skip
    sliding = np.array([
        [half_x, lower], [tips[1], lower], [tips[1], lower - 0.35 * h], [half_x + 0.4 * depth, lower - h],
        [-half_x - 0.012 * length, lower - h], [-half_x - 0.012 * length, lower - 0.3 * h],
    ])  # fmt: skip
    radius = 0.9 * t
    bracket = np.array([
        [-half_x - 0.01 * length, half_length - 0.015 * length], [half_x + 2.0 * radius, half_length],
        [half_x + 2.0 * radius, half_length + 0.03 * length], [-half_x - 0.01 * length, half_length + 0.03 * length],
    ])  # fmt: skip
    bar = _box(-half_x, half_x, half_length - 0.01 * length, upper + 0.5 * head)
    shift = np.array([half_x + 1.1 * radius, 0.0, 0.0])
    rod = stack(np.array([half_length, lower - 0.5 * h]), 0.4 * radius, None, superellipse(2.0, 16)) + shift
    top = lower - h + 0.001
    low = top - length * rng.uniform(0.07, 0.1)
    edge = 0.006 * length
    knurl = lobes(int(rng.integers(14, 26)), 0.1, 96)
    worm = stack(
        np.array([low, low + edge, top - edge, top]), radius * np.array([0.9, 1.0, 1.0, 0.9]), None, knurl
    ) + shift  # fmt: skip

    if rng.uniform() < 0.5:
        handle, grip = _bar(rng, half_length, half_length, half_x * rng.uniform(0.9, 1.15), t * 0.7, steel)
    else:
        grip_x = length * rng.uniform(0.042, 0.055)
        handle, grip = _wooden_grip(rng, half_length, max(grip_x, 1.1 * half_x), max(0.75 * grip_x, 1.2 * half_y))
    pieces = [
        grip,
        Piece("bar", _plate(cross_section(bar), half_y), steel, (_prism(bar, half_y),)),
        Piece("bracket", _plate(cross_section(bracket), 0.85 * t), steel, (_prism(bracket, 0.85 * t),)),
        loft_piece("screw", rod, steel),
        loft_piece("worm", worm, steel, 0.2),
        Piece("sliding_jaw", _plate(cross_section(sliding), t), steel, (_prism(sliding, t),)),
        Piece("jaw", _plate(cross_section(fixed), t), steel, (_prism(fixed, t),)),
    ]
    return assemble(kind, seed, pieces, (_ee(0.5 * (half_x + min(tips)), lower + 0.5 * opening, handle),), handle)


def _ee(x: float, z: float, handle: Handle) -> EndEffector:
    """EE half-way between the throat and the end of the shorter jaw, and between the jaws."""
    p = np.array([x, 0.0, z])
    return EndEffector(
        Category.WRENCH_HEAD,
        frame_from_axes(z=np.array([0.0, 1.0, 0.0]), x=np.array([0.0, 0.0, handle.z_min]) - p, p=p),
    )


def _bar(
    rng: np.random.Generator, half_length: float, top: float, half_x: float, half_y: float, material: Material
) -> tuple[Handle, Piece]:
    """A metal handle from z = -half_length to `top`, of which the part up to half_length is free; widths [m].

    Optional are sunk panels on both flat sides and a hanging hole.
    """
    z = np.unique(np.concatenate([np.linspace(-half_length, top, 28), [0.003 - half_length, half_length]]))
    u = (z + half_length) / (top + half_length)
    narrow, swell = rng.uniform(0.62, 0.85), rng.uniform(0.0, 0.2)
    a = half_x * (narrow + (1 - narrow) * u**1.5 + swell * np.exp(-((u / 0.15) ** 2)))
    b = np.full(len(z), half_y)
    a[0] *= 0.75
    b[0] *= 0.8
    exponent = float(rng.choice([2.5, 4.0, 7.0]))
    rings = stack(z, a, b, superellipse(exponent))
    solid = loft(rings)
    hole = rng.uniform() < 0.6
    start = -half_length + (3.2 if hole else 1.2) * half_x
    if exponent > 3 and rng.uniform() < 0.6:
        panel = superellipse(6.0, 32) * [0.6 * a.min(), 0.5 * (half_length - start)] + np.array(
            [0.0, 0.5 * (half_length + start)]
        )
        sunk = rng.uniform(0.15, 0.4) * half_y
        for low, high in ((-2 * half_y, sunk - half_y), (half_y - sunk, 2 * half_y)):
            solid = solid - place(extrude(panel, low, high), _UPRIGHT)
    if hole:
        circle = superellipse(2.0, 24) * rng.uniform(0.3, 0.45) * half_x + np.array([0.0, 1.4 * half_x - half_length])
        solid = solid - _plate(cross_section(circle), 2 * half_y)
    free = z <= half_length
    return Handle(z[free], a[free], b[free]), Piece("handle", solid, material, (Convex(rings, 0.12),))


def _wooden_grip(rng: np.random.Generator, half_length: float, half_x: float, half_y: float) -> tuple[Handle, Piece]:
    """An oval wooden handle that swells towards its middle."""
    z = np.unique(np.concatenate([np.linspace(-half_length, half_length, 22), [0.004 - half_length]]))
    u = z / half_length
    scale = rng.uniform(0.75, 0.95) + rng.uniform(0.1, 0.25) * (1 - u**2)
    scale[0] *= 0.75
    rings = stack(z, half_x * scale, half_y * scale, superellipse(2.4))
    return Handle(z, half_x * scale, half_y * scale), loft_piece("handle", rings, varied(WOOD, rng), 0.12)


def _toothed(outline: Array, z: float, side: float, pitch: float) -> Any:
    """An outline with teeth across the jaw whose flat lies at z; side 1: the flat looks up."""
    flat = outline[np.abs(outline[:, 1] - z) < 1e-6]
    low, high = flat[:, 0].min(), flat[:, 0].max()
    count = int((high - low) / pitch) - 1
    start = 0.5 * (low + high - count * pitch)
    depth = 0.4 * pitch
    tooth = np.array([[0.0, 0.001], [0.0, 0.0], [0.35 * pitch, -depth], [0.8 * pitch, 0.0], [0.8 * pitch, 0.001]])
    cuts = [tooth * [1.0, side] + np.array([start + k * pitch, z]) for k in range(count)]
    return cross_section(outline) - manifold3d.CrossSection(cuts, manifold3d.FillRule.NonZero)


def _plate(region: Any, half_y: float) -> Any:
    return place(extrude(region, -half_y, half_y), _UPRIGHT)


def _prism(outline: Array, half_y: float) -> Convex:
    return Convex(move(prism_points(outline, -half_y, half_y), _UPRIGHT))


def _box(x_min: float, x_max: float, z_min: float, z_max: float) -> Array:
    return np.array([[x_min, z_min], [x_max, z_min], [x_max, z_max], [x_min, z_max]])


def _corners(region: Any) -> Array:
    return np.concatenate([np.asarray(polygon) for polygon in region.to_polygons()])


def _circle(x: float, z: float, radius: float) -> Array:
    return radius * superellipse(2.0, 24) + np.array([x, z])
