"""Heads of claw, ball-peen, cross-peen and club hammers, and of mallets.

Head axes are parallel to the EE frame of the striking face: z along the head, out of the face; x towards the butt of
the handle; origin at the intersection of the centre lines of handle and head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.tools.materials import BRASS, PLASTIC, RUBBER, WOOD, Material, steel, varied
from toolee_robot.tools.sections import regular_polygon, stack, superellipse
from toolee_robot.tools.solids import Convex, Piece, loft, loft_piece


@dataclass(frozen=True, eq=False)
class Head:
    """A hammer head in head axes.

    Attributes:
        pieces: Solids of the head [m].
        ees: Category and pose (4x4) of each end effector, the working end first.
        half_height: Half-extent of the cheek along the handle [m].
        eye: Half-widths [m] of the eye along head z and y.
    """

    pieces: list[Piece]
    ees: tuple[tuple[Category, Array], ...]
    half_height: float
    eye: tuple[float, float]


def _face_section(rng: np.random.Generator, shapes: tuple[str, ...] = ("round", "round", "octagon", "square")) -> Array:
    match rng.choice(shapes):
        case "octagon":
            return regular_polygon(8, 32, rng.uniform(0.0, 0.3))
        case "square":
            return superellipse(rng.uniform(4.0, 9.0), 32)
        case _:
            return superellipse(2.0, 32)


def _body(rng: np.random.Generator, half: float, height: float, width: float, material: Material) -> Piece:
    """Cheeks around the eye: z from -half to half; half-extents `height` along the handle, `width` across it; [m]."""
    bevel = rng.uniform(0.001, 0.003)
    z = np.array([-half, -half + bevel, half - bevel, half])
    inset = np.array([bevel, 0.0, 0.0, bevel])
    rings = stack(z, height - inset, width - inset, superellipse(rng.uniform(2.5, 7.0)))
    return loft_piece("body", rings, material)


def _poll(
    rng: np.random.Generator, start: float, end: float, root: tuple[float, float], radius: float, section: Array,
    material: Material, *, necked: bool, label: str = "face",
) -> Piece:  # fmt: skip
    """The poll: from the body (z = start, half-extents `root`) over a neck to the striking face at z = end; all [m]."""
    length = end - start
    chamfer = rng.uniform(0.04, 0.16) * radius
    face_thickness = min(rng.uniform(0.25, 0.6) * length, length - 0.006)
    neck = rng.uniform(0.62, 0.92) * radius if necked else radius * rng.uniform(0.92, 1.0)
    z = np.array(
        [start - 0.004, start, start + 0.4 * (length - face_thickness), end - face_thickness, end - chamfer, end]
    )
    z[3] = min(z[3], end - chamfer - 0.001)
    a = np.array([root[0], root[0], neck, radius, radius, radius - chamfer])
    b = np.array([root[1], root[1], neck, radius, radius, radius - chamfer])
    circle = superellipse(2.0, 32)
    rings = stack(z, a, b, np.stack([circle, circle, 0.5 * (circle + section), section, section, section]))
    return loft_piece(label, rings, material)


def claw_head(rng: np.random.Generator) -> Head:
    """Generate a head with a striking face and a claw, whose end effector is the grip between its tines."""
    material = steel(rng)
    length = rng.uniform(0.095, 0.140)
    radius = rng.uniform(0.011, 0.0175)
    height = radius * rng.uniform(0.75, 1.1)
    width = radius * rng.uniform(0.75, 1.0)
    half = rng.uniform(0.012, 0.017)
    front = length * rng.uniform(0.38, 0.5)
    body = _body(rng, half, height, width, material)
    poll = _poll(
        rng, half - 0.002, front, (0.8 * height, 0.8 * width), radius, _face_section(rng), material, necked=True
    )
    claw, X_grip = _claw(rng, half, length - front - half, height, width, material)
    face = transform(None, [0.0, 0.0, front])
    return Head(
        [body, poll, claw],
        ((Category.HAMMER_HEAD, face), (Category.HAMMER_GRIP, X_grip)),
        height,
        (half * rng.uniform(0.55, 0.75), width * rng.uniform(0.5, 0.7)),
    )


def _claw(
    rng: np.random.Generator, half: float, reach: float, height: float, width: float, material: Material
) -> tuple[Piece, Array]:
    """The claw behind the body, a slotted plate along a curve that bends towards the handle, and its EE pose (4x4)."""
    n = 26
    turn = np.deg2rad(rng.uniform(4.0, 25.0) if rng.uniform() < 0.35 else rng.uniform(25.0, 80.0))
    start_angle = np.deg2rad(rng.uniform(-8.0, 5.0))
    growth = rng.uniform(0.8, 1.6)
    u = np.linspace(0.0, 1.0, n)
    phi = start_angle + turn * u**growth
    tangent = np.column_stack([np.sin(phi), np.zeros(n), -np.cos(phi)])
    steps = 0.5 * (tangent[1:] + tangent[:-1]) / (n - 1)
    curve = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, 0)])
    arc = (reach + 0.004) / -curve[:, 2].min()
    root_thickness = height * rng.uniform(0.5, 0.95)
    # The back of the claw is about flush with the top of the body (x points towards the handle).
    curve = curve * arc + [-(height - root_thickness) * rng.uniform(0.4, 1.0), 0.0, -half + 0.004]
    away = np.column_stack([-np.cos(phi), np.zeros(n), -np.sin(phi)])
    tip_thickness = rng.uniform(0.0008, 0.0018)
    thickness = tip_thickness + (root_thickness - tip_thickness) * (1 - u) ** rng.uniform(0.7, 1.3)
    tip_width = rng.uniform(0.0105, 0.0175)
    across = 0.85 * width + (tip_width - 0.85 * width) * np.sqrt(u)
    section = superellipse(rng.uniform(4.0, 9.0))

    def ring(i: int, y_low: float, y_high: float) -> Array:
        y = 0.5 * (y_low + y_high) + 0.5 * (y_high - y_low) * section[:, 1]
        return curve[i] + thickness[i] * section[:, :1] * away[i] + y[:, None] * np.array([0.0, 1.0, 0.0])

    rings = np.stack([ring(i, -across[i], across[i]) for i in range(n)])
    first = int(np.clip(round(n * rng.uniform(0.28, 0.55)), 5, n - 8))
    root_gap, tip_gap = rng.uniform(0.0010, 0.0020), min(rng.uniform(0.0035, 0.0080), tip_width - 0.0055)
    slot_u = (u[first:] - u[first]) / (1 - u[first])
    gap = root_gap + (tip_gap - root_gap) * slot_u
    tall = 2.5 * root_thickness
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    cutter = [
        curve[i] + tall * corners[:, :1] * away[i] + g * corners[:, 1:] * np.array([0.0, 1.0, 0.0])
        for i, g in zip(range(first, n), gap, strict=True)
    ]
    cutter.append(cutter[-1] + 0.01 * tangent[-1])
    claw = loft(rings) - loft(np.stack(cutter))
    tines = [
        np.stack([ring(i, *sorted((side * g, side * across[i]))) for i, g in zip(range(first, n), gap, strict=True)])
        for side in (-1.0, 1.0)
    ]
    convex = (Convex(rings[: first + 1], 0.2), Convex(tines[0], 0.25), Convex(tines[1], 0.25))
    middle = 0.5 * (u[first] + 1.0)
    p = np.array([np.interp(middle, u, curve[:, k]) for k in range(3)])
    angle = float(np.interp(middle, u, phi))
    X_grip = frame_from_axes(
        z=np.array([-np.cos(angle), 0.0, -np.sin(angle)]), x=np.array([np.sin(angle), 0.0, -np.cos(angle)]), p=p
    )
    return Piece("claw", claw, material, convex), X_grip


def ball_peen_head(rng: np.random.Generator) -> Head:
    """Generate a head with a striking face, and a ball behind the body."""
    material = steel(rng)
    length = rng.uniform(0.075, 0.125)
    radius = rng.uniform(0.011, 0.020)
    height, width = radius * rng.uniform(0.8, 1.05), radius * rng.uniform(0.75, 0.95)
    half = rng.uniform(0.011, 0.016)
    front = length * rng.uniform(0.45, 0.55)
    body = _body(rng, half, height, width, material)
    poll = _poll(
        rng, half - 0.002, front, (0.8 * height, 0.8 * width), radius, _face_section(rng), material, necked=True
    )
    back, ball = length - front, radius * rng.uniform(0.8, 1.0)
    ball = min(ball, 0.75 * (back - half))
    polar = np.linspace(0.08, 0.72 * np.pi, 11)
    z = np.concatenate([-back + ball * (1 - np.cos(polar)), [-half - 0.001, -half + 0.004]])
    neck = 0.8 * min(height, width)
    a = np.concatenate([ball * np.sin(polar), [neck, neck]])
    z[-2] = max(z[-2], z[-3] + 1e-3)
    rings = stack(z, a)
    peen = loft_piece("peen", rings, material, 0.08)
    return _one_faced([body, poll, peen], front, height, half, width, rng)


def cross_peen_head(rng: np.random.Generator) -> Head:
    """Generate a head with a striking face and a wedge, whose edge runs across the handle or, more rarely, along it."""
    material = steel(rng)
    length = rng.uniform(0.075, 0.130)
    radius = rng.uniform(0.010, 0.018)
    section = _face_section(rng, ("round", "square", "square", "octagon"))
    height, width = radius * rng.uniform(0.9, 1.05), radius * rng.uniform(0.85, 1.0)
    half = rng.uniform(0.011, 0.016)
    front = length * rng.uniform(0.42, 0.55)
    body = _body(rng, half, height, width, material)
    poll = _poll(
        rng, half - 0.002, front, (0.9 * height, 0.9 * width), radius, section, material,
        necked=rng.uniform() < 0.4,
    )  # fmt: skip
    edge = rng.uniform(0.001, 0.004)
    z = np.array([-(length - front), -(length - front) + edge, -half - 0.001, -half + 0.004])
    narrow = np.array([0.6 * edge, edge, 0.85 * height, 0.85 * height])
    broad = np.array([0.85, 0.92, 0.9, 0.9]) * width
    a, b = (narrow, broad) if rng.uniform() < 0.75 else (broad, narrow)
    # Some wedges have one straight side, so that the edge is off centre.
    drop = rng.uniform(-0.95, 0.5) * np.array([height, height, 0.0, 0.0]) * (rng.uniform() < 0.5) * (a is narrow)
    rings = stack(z, a, b, superellipse(rng.uniform(4.0, 8.0)), drop)
    peen = loft_piece("peen", rings, material)
    return _one_faced([body, poll, peen], front, height, half, width, rng)


def _one_faced(
    pieces: list[Piece], front: float, height: float, half: float, width: float, rng: np.random.Generator
) -> Head:
    face = transform(None, [0.0, 0.0, front])
    eye = (half * rng.uniform(0.55, 0.75), width * rng.uniform(0.5, 0.7))
    return Head(pieces, ((Category.HAMMER_HEAD, face),), height, eye)


def _double_faced(pieces: list[Piece], front: float, back: float, height: float, eye: tuple[float, float]) -> Head:
    """A head with two striking faces; the second frame is the first one rotated by 180 degrees about the handle."""
    turned = transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, -back])
    faces = ((Category.HAMMER_HEAD, transform(None, [0.0, 0.0, front])), (Category.HAMMER_HEAD, turned))
    return Head(pieces, faces, height, eye)


def club_head(rng: np.random.Generator) -> Head:
    """Generate a short, heavy head with two striking faces."""
    material = steel(rng)
    length = rng.uniform(0.070, 0.110)
    radius = rng.uniform(0.014, 0.0225)
    section = _face_section(rng, ("square", "octagon", "octagon", "round"))
    half = length / 2
    chamfer = rng.uniform(0.08, 0.2) * radius
    waist = rng.uniform(0.88, 1.0)
    z = np.array([-half, -half + chamfer, -0.5 * half, 0.0, 0.5 * half, half - chamfer, half])
    a = radius * np.array([1.0, 1.0, 0.5 + 0.5 * waist, waist, 0.5 + 0.5 * waist, 1.0, 1.0])
    a[[0, -1]] -= chamfer
    rings = stack(z, a, a, section)
    block = loft_piece("face", rings, material)
    eye = (rng.uniform(0.009, 0.0125), min(0.55 * radius * waist, 0.010))
    return _double_faced([block], half, half, radius * waist, eye)


def mallet_head(rng: np.random.Generator) -> Head:
    """Generate a head with two soft faces: one piece of rubber or wood, or a metal body with soft caps."""
    length = rng.uniform(0.080, 0.130)
    half = length / 2
    if rng.uniform() < 0.65:
        material = varied(RUBBER if rng.uniform() < 0.7 else WOOD, rng)
        radius = rng.uniform(0.019, 0.0265) if material.name == "rubber" else rng.uniform(0.026, 0.034)
        section = _face_section(
            rng, ("round", "round", "octagon") if material.name == "rubber" else ("round", "square")
        )
        chamfer = rng.uniform(0.05, 0.18) * radius
        bulge = rng.uniform(0.92, 1.2) if material.name == "rubber" else rng.uniform(0.92, 1.05)
        u = np.linspace(-1.0, 1.0, 9)
        z = np.concatenate([[-half], u * (half - chamfer), [half]])
        a = radius * np.array([1.0, *(1.0 + (bulge - 1.0) * (1 - u**2)), 1.0])
        a[[0, -1]] -= chamfer
        rings = stack(z, a, a, section)
        pieces = [loft_piece("face", rings, material)]
        height = radius * bulge
    else:
        radius = rng.uniform(0.014, 0.0225)
        height = radius * rng.uniform(0.8, 1.0)
        core = half * rng.uniform(0.45, 0.7)
        body = _body(rng, core, height, height * rng.uniform(0.85, 1.0), steel(rng))
        pieces = [body]
        for side in (1.0, -1.0):
            cap_material = varied((PLASTIC, RUBBER, BRASS)[rng.choice(3, p=[0.5, 0.35, 0.15])], rng)
            chamfer = rng.uniform(0.05, 0.15) * radius
            z = side * np.array([core - 0.002, half - chamfer, half])
            rings = stack(z, np.array([radius, radius, radius - chamfer]))
            pieces.append(loft_piece("face", rings, cap_material))
    eye = (rng.uniform(0.010, 0.0135), min(0.6 * height, rng.uniform(0.008, 0.012)))
    return _double_faced(pieces, half, half, height, eye)
