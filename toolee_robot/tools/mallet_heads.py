"""Heads of mallets and meat tenderisers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import manifold3d
import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, rotation_z, transform
from toolee_robot.tools.hammer_heads import Head, body_piece, double_faced, face_section
from toolee_robot.tools.materials import ALUMINIUM, BRASS, PLASTIC, RUBBER, STEEL_BRIGHT, WOOD, steel, varied
from toolee_robot.tools.solids import extrude, loft_piece, place, stack, superellipse


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
