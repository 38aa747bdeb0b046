"""Heads of ball-peen, cross-peen, club and sledge hammers, and what heads of all hammers are made of.

Head axes are parallel to the EE frame of the striking face: z along the head, out of the face; x towards the butt of
the handle; origin at the intersection of the centre lines of handle and head.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import manifold3d
import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, rotation_z, transform
from toolee_robot.tools.materials import ALUMINIUM, BRASS, PLASTIC, RUBBER, STEEL_BRIGHT, WOOD, Material, steel, varied
from toolee_robot.tools.solids import Piece, extrude, loft_piece, place, regular_polygon, stack, superellipse


@dataclass(frozen=True, eq=False)
class Head:
    """A hammer head in head axes.

    Attributes:
        pieces: Solids of the head [m].
        ees: Category and pose (4x4) of each end effector, the working end first.
        half_height: Half-extent of the cheek along the handle [m].
        eye: Half-widths [m] of the eye along head z and y.
        turned: Material of a handle turned on a lathe; None: the handle of a hammer.
    """

    pieces: list[Piece]
    ees: tuple[tuple[Category, Array], ...]
    half_height: float
    eye: tuple[float, float]
    turned: Material | None = None


def face_section(rng: np.random.Generator, shapes: tuple[str, ...] = ("round", "round", "octagon", "square")) -> Array:
    """Draw the outline of a striking face.

    Args:
        rng: Random generator of the tool.
        shapes: "round", "octagon" and "square", as often as they are to be drawn.

    Returns:
        The outline, with an inradius of 1, (32, 2).
    """
    match rng.choice(shapes):
        case "octagon":
            return regular_polygon(8, 32, rng.uniform(0.0, 0.3))
        case "square":
            return superellipse(rng.uniform(4.0, 9.0), 32)
        case _:
            return superellipse(2.0, 32)


def body_piece(rng: np.random.Generator, half: float, height: float, width: float, material: Material) -> Piece:
    """Generate the cheeks around the eye.

    Args:
        rng: Random generator of the tool.
        half: Half-extent along the head [m].
        height: Half-extent along the handle [m].
        width: Half-extent across both [m].
        material: Its material.

    Returns:
        The body, centred on the head's origin.
    """
    bevel = rng.uniform(0.001, 0.003)
    z = np.array([-half, -half + bevel, half - bevel, half])
    inset = np.array([bevel, 0.0, 0.0, bevel])
    rings = stack(z, height - inset, width - inset, superellipse(rng.uniform(2.5, 7.0)))
    return loft_piece("body", rings, material)


def poll_piece(
    rng: np.random.Generator, start: float, end: float, root: tuple[float, float], radius: float, section: Array,
    material: Material, *, necked: bool,
) -> Piece:  # fmt: skip
    """Generate the poll: from the body over a neck to the striking face.

    Args:
        rng: Random generator of the tool.
        start: z of the end of the body [m].
        end: z of the striking face [m].
        root: Half-extents along and across the handle where it leaves the body [m].
        radius: Inradius behind the face's chamfer [m].
        section: Outline of the face, (32, 2).
        material: Its material.
        necked: Whether the neck is clearly narrower than the face.

    Returns:
        The poll, in head axes.
    """
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
    return loft_piece("face", rings, material)


def ball_peen_head(rng: np.random.Generator) -> Head:
    """Generate a head with a striking face, and a ball behind the body."""
    material = steel(rng)
    length = rng.uniform(0.075, 0.125)
    radius = rng.uniform(0.011, 0.020)
    height, width = radius * rng.uniform(0.8, 1.05), radius * rng.uniform(0.75, 0.95)
    half = rng.uniform(0.011, 0.016)
    front = length * rng.uniform(0.45, 0.55)
    body = body_piece(rng, half, height, width, material)
    poll = poll_piece(
        rng, half - 0.002, front, (0.8 * height, 0.8 * width), radius, face_section(rng), material, necked=True
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
    section = face_section(rng, ("round", "square", "square", "octagon"))
    height, width = radius * rng.uniform(0.9, 1.05), radius * rng.uniform(0.85, 1.0)
    half = rng.uniform(0.011, 0.016)
    front = length * rng.uniform(0.42, 0.55)
    body = body_piece(rng, half, height, width, material)
    poll = poll_piece(
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


def double_faced(pieces: list[Piece], front: float, back: float, height: float, eye: tuple[float, float]) -> Head:
    """A head with two striking faces; the second frame is the first one rotated by 180 degrees about the handle.

    Args:
        pieces: Solids of the head, in head axes.
        front: Distance of the first face from the origin [m].
        back: Distance of the second face [m].
        height: Half-extent along the handle [m].
        eye: Half-widths [m] of the eye along head z and y.

    Returns:
        The head.
    """
    turned = transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, -back])
    faces = ((Category.HAMMER_HEAD, transform(None, [0.0, 0.0, front])), (Category.HAMMER_HEAD, turned))
    return Head(pieces, faces, height, eye)


def club_head(rng: np.random.Generator) -> Head:
    """Generate a short, heavy head with two striking faces."""
    return _block_head(rng, length=(0.070, 0.110), radius=(0.014, 0.0225), eye=(0.009, 0.0125), broadest_eye=0.010)


def sledge_head(rng: np.random.Generator) -> Head:
    """Generate the head of a heavy club hammer or a sledge hammer, with two striking faces.

    From the club hammers of the trade (DIN 6475: 1 to 2 kg) to the lightest sledge hammers (DIN 1042: from 5 kg);
    lengths and faces follow from these masses at the usual proportions.
    """
    return _block_head(rng, length=(0.100, 0.165), radius=(0.020, 0.033), eye=(0.012, 0.0165), broadest_eye=0.013)


def _block_head(
    rng: np.random.Generator, *, length: tuple[float, float], radius: tuple[float, float], eye: tuple[float, float],
    broadest_eye: float,
) -> Head:  # fmt: skip
    """A block with two faces; ranges of its length, of the faces' inradius and of the eye's half-width [m]."""
    material = steel(rng)
    half = rng.uniform(*length) / 2
    r = rng.uniform(*radius)
    section = face_section(rng, ("square", "octagon", "octagon", "round"))
    chamfer = rng.uniform(0.08, 0.2) * r
    waist = rng.uniform(0.88, 1.0)
    z = np.array([-half, -half + chamfer, -0.5 * half, 0.0, 0.5 * half, half - chamfer, half])
    a = r * np.array([1.0, 1.0, 0.5 + 0.5 * waist, waist, 0.5 + 0.5 * waist, 1.0, 1.0])
    a[[0, -1]] -= chamfer
    rings = stack(z, a, a, section)
    block = loft_piece("face", rings, material)
    return double_faced([block], half, half, r * waist, (rng.uniform(*eye), min(0.55 * r * waist, broadest_eye)))


def mallet_head(rng: np.random.Generator) -> Head:
    """Generate a head with two soft faces: one piece of rubber or wood, or a metal body with soft caps."""
    length = rng.uniform(0.080, 0.130)
    half = length / 2
    if rng.uniform() < 0.65:
        material = varied(RUBBER if rng.uniform() < 0.7 else WOOD, rng)
        radius = rng.uniform(0.019, 0.0265) if material.name == "rubber" else rng.uniform(0.026, 0.034)
        section = face_section(rng, ("round", "round", "octagon") if material.name == "rubber" else ("round", "square"))
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
        body = body_piece(rng, core, height, height * rng.uniform(0.85, 1.0), steel(rng))
        pieces = [body]
        for side in (1.0, -1.0):
            cap_material = varied((PLASTIC, RUBBER, BRASS)[rng.choice(3, p=[0.5, 0.35, 0.15])], rng)
            chamfer = rng.uniform(0.05, 0.15) * radius
            z = side * np.array([core - 0.002, half - chamfer, half])
            rings = stack(z, np.array([radius, radius, radius - chamfer]))
            pieces.append(loft_piece("face", rings, cap_material))
    eye = (rng.uniform(0.010, 0.0135), min(0.6 * height, rng.uniform(0.008, 0.012)))
    return double_faced(pieces, half, half, height, eye)


def wooden_mallet_head(rng: np.random.Generator) -> Head:
    """Generate a small wooden head with two faces, a cylinder or a box, for a turned handle.

    From crab mallets (heads of some 65 x 38 mm) to the smaller joiner's mallets (120 x 70 x 60 mm), whose faces lean.
    """
    material = varied(WOOD, rng)
    half = rng.uniform(0.0275, 0.0625)
    u = np.linspace(-1.0, 1.0, 9)
    lean = 0.0
    if rng.uniform() < 0.55:
        height = width = float(np.clip(2 * half * rng.uniform(0.24, 0.38), 0.016, 0.036))
        section = superellipse(2.0, 40)
        profile = 1.0 + rng.uniform(-0.08, 0.12) * (1 - u**2)
    else:
        height = float(np.clip(2 * half * rng.uniform(0.22, 0.42), 0.016, 0.036))
        width = float(np.clip(height * rng.uniform(0.65, 1.0), 0.015, 0.033))
        section = superellipse(rng.uniform(7.0, 14.0), 40)
        profile = np.ones(9)
        if rng.uniform() < 0.5:
            # The butt of the longest handle stays behind the faces.
            most = np.arctan((half - 0.021) / 0.30) - np.deg2rad(1.2)
            lean = rng.uniform(0.3, 1.0) * min(most, np.deg2rad(4.5))
    chamfer = rng.uniform(0.04, 0.14) * width
    z = np.concatenate([[-half], u * (half - chamfer), [half]])
    scale = np.array([1.0, *profile, 1.0])
    inset = chamfer * np.array([1.0, *np.zeros(9), 1.0])
    rings = stack(z, height * scale - inset, width * scale - inset, section)
    # Both faces lean towards the butt: the head is longer at its top.
    rings[..., 2] *= 1.0 - np.tan(lean) * rings[..., 0] / half
    eye = min(rng.uniform(0.0055, 0.0095), 0.5 * width)
    middle = height * float(profile[4])
    head = double_faced([loft_piece("face", rings, material)], half, half, middle, (eye, eye))
    tilt = transform(Rotation.from_euler("y", lean).as_matrix())
    handle = material if rng.uniform() < 0.5 else varied(WOOD, rng)
    return replace(head, ees=tuple((category, X @ tilt) for category, X in head.ees), turned=handle)


def tenderiser_head(rng: np.random.Generator) -> Head:
    """Generate the head of a meat tenderiser: rows of pyramids on one face; the other one is flat or has finer ones.

    Of cast aluminium or steel 38 to 54 mm square and 52 to 75 mm long, of wood up to 60 mm square and 110 mm long,
    estimated from what kitchen shops sell. The frame of a toothed face lies in the plane of the pyramids' tops.
    """
    metal = rng.uniform() < 0.6
    if metal:
        material = varied(ALUMINIUM if rng.uniform() < 0.7 else STEEL_BRIGHT, rng)
        radius, half = rng.uniform(0.019, 0.027), rng.uniform(0.026, 0.0375)
        waist = rng.uniform(0.6, 1.0)
    else:
        material = varied(WOOD, rng)
        radius, half = rng.uniform(0.021, 0.030), rng.uniform(0.030, 0.055)
        waist = rng.uniform(0.9, 1.0)
    round_head = rng.uniform() < 0.12
    section = superellipse(2.0, 40) if round_head else superellipse(rng.uniform(9.0, 16.0), 40)
    plate = rng.uniform(0.25, 0.45) * half
    z = np.array([-half, plate - half, 1.4 * plate - half, half - 1.4 * plate, half - plate, half])
    rings = stack(z, radius * np.array([1.0, 1.0, waist, waist, 1.0, 1.0]), None, section)
    block = loft_piece("face", rings, material)
    coarse = int(rng.integers(4, 8))
    grooves = [_grooves(rng, radius, half, coarse)]
    if rng.uniform() < 0.6:
        turned = transform(np.diag([1.0, -1.0, -1.0]))
        grooves.append(place(_grooves(rng, radius, half, coarse + int(rng.integers(2, 5))), turned))
    block = replace(block, solid=block.solid - manifold3d.Manifold.batch_boolean(grooves, manifold3d.OpType.Add))
    height = radius * waist
    eye = min(rng.uniform(0.006, 0.009), 0.5 * height)
    handle = material if rng.uniform() < 0.7 else varied(WOOD if rng.uniform() < 0.6 else PLASTIC, rng)
    return replace(double_faced([block], half, half, height, (eye, eye)), turned=handle)


def _grooves(rng: np.random.Generator, radius: float, z: float, rows: int) -> Any:
    """What is cut from a face at height z, of half-width `radius`, to leave rows x rows blunt pyramids; [m]."""
    pitch = 2 * radius / rows
    w = 0.5 * pitch * rng.uniform(0.8, 0.94)
    depth = pitch * rng.uniform(0.35, 0.6)
    v: Array = np.array([[-w, 0.002], [-w, 0.0], [0.0, -depth], [w, 0.0], [w, 0.002]])
    triangles = manifold3d.CrossSection(
        [v + np.array([pitch * k - radius, z]) for k in range(rows + 1)], manifold3d.FillRule.NonZero
    )
    along = extrude(triangles, -1.5 * radius, 1.5 * radius)
    up = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
    return place(along, up) + place(along, transform(rotation_z(np.pi / 2)) @ up)
