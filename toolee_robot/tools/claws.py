"""Heads with a claw: of claw hammers, whose claw is nearly straight to curved, and of those whose claw hangs."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.tools.hammer_heads import Head, body_piece, face_section, poll_piece
from toolee_robot.tools.materials import Material, steel
from toolee_robot.tools.solids import Convex, Piece, loft, superellipse

_RINGS = 26
"""Number of sections of a claw."""


def claw_head(rng: np.random.Generator) -> Head:
    """Generate a head with a striking face and a claw, whose end effector is the grip between its tines."""
    material = steel(rng)
    length = rng.uniform(0.095, 0.140)
    radius = rng.uniform(0.011, 0.0175)
    height = radius * rng.uniform(0.75, 1.1)
    width = radius * rng.uniform(0.75, 1.0)
    half = rng.uniform(0.012, 0.017)
    front = length * rng.uniform(0.38, 0.5)
    pieces = _body_and_poll(rng, radius, height, width, half, front, material)
    claw, X_grip = _claw(rng, half, length - front - half, height, width, material)
    return _head(rng, [*pieces, claw], X_grip, height, width, half, front)


def hanging_claw_head(rng: np.random.Generator) -> Head:
    """Generate a head whose claw turns by 60 to 100 degrees, so that its tips hang 20 to 45 mm below the head's top.

    The slot slants down behind the handle, and its walls lean. Sizes are those of curved claw hammers of 16 to 20 oz,
    estimated, not measured.
    """
    material = steel(rng)
    radius = rng.uniform(0.0125, 0.0165)
    height = radius * rng.uniform(0.75, 1.05)
    width = radius * rng.uniform(0.75, 1.0)
    half = rng.uniform(0.012, 0.017)
    front = rng.uniform(0.045, 0.064)
    pieces = _body_and_poll(rng, radius, height, width, half, front, material)
    claw, X_grip = _hanging_claw(rng, half, height, width, material)
    return _head(rng, [*pieces, claw], X_grip, height, width, half, front)


def _body_and_poll(
    rng: np.random.Generator, radius: float, height: float, width: float, half: float, front: float, material: Material
) -> list[Piece]:
    body = body_piece(rng, half, height, width, material)
    root = (0.8 * height, 0.8 * width)
    return [body, poll_piece(rng, half - 0.002, front, root, radius, face_section(rng), material, necked=True)]


def _head(
    rng: np.random.Generator, pieces: list[Piece], X_grip: Array, height: float, width: float, half: float, front: float
) -> Head:
    face = transform(None, [0.0, 0.0, front])
    eye = (half * rng.uniform(0.55, 0.75), width * rng.uniform(0.5, 0.7))
    return Head(pieces, ((Category.HAMMER_HEAD, face), (Category.HAMMER_GRIP, X_grip)), height, eye)


def _claw(
    rng: np.random.Generator, half: float, reach: float, height: float, width: float, material: Material
) -> tuple[Piece, Array]:
    """The claw behind the body, a slotted plate along a curve that bends towards the handle, and its EE pose (4x4)."""
    turn = np.deg2rad(rng.uniform(4.0, 25.0) if rng.uniform() < 0.35 else rng.uniform(25.0, 80.0))
    start_angle = np.deg2rad(rng.uniform(-8.0, 5.0))
    growth = rng.uniform(0.8, 1.6)
    phi, curve = _curve(start_angle, turn, growth, reach)
    root_thickness = height * rng.uniform(0.5, 0.95)
    # The back of the claw is about flush with the top of the body (x points towards the handle).
    curve += [-(height - root_thickness) * rng.uniform(0.4, 1.0), 0.0, -half + 0.004]
    return _slotted_plate(rng, curve, phi, root_thickness, width, material)


def _hanging_claw(
    rng: np.random.Generator, half: float, height: float, width: float, material: Material
) -> tuple[Piece, Array]:
    """A claw as `_claw`; a shape that would reach too far or not far enough to hang as low as drawn is drawn again."""
    for _ in range(200):
        hang = rng.uniform(0.020, 0.045)
        turn, start_angle = np.deg2rad(rng.uniform(60.0, 100.0)), np.deg2rad(rng.uniform(-6.0, 8.0))
        phi, curve = _curve(start_angle, turn, rng.uniform(0.95, 1.5), 0.046)
        root_thickness = height * rng.uniform(0.5, 0.8)
        root = -(height - root_thickness) * rng.uniform(0.6, 1.0)
        curve *= (hang - height - root) / curve[-1, 0]
        if 0.024 <= -curve[:, 2].min() <= 0.064:
            curve += [root, 0.0, -half + 0.004]
            return _slotted_plate(rng, curve, phi, root_thickness, width, material, lean=rng.uniform(0.0, 0.5))
    raise AssertionError("no claw hangs as low as it should")


def _curve(start_angle: float, turn: float, growth: float, reach: float) -> tuple[Array, Array]:
    """Middle of a claw that leaves the body at an angle and bends towards the handle.

    Args:
        start_angle: Angle to the axis of the head at the root [rad], positive towards the handle.
        turn: Angle by which it bends from root to tips [rad].
        growth: Exponent of the angle over the length; above 1 it bends more towards its tips.
        reach: Length along the axis of the head [m].

    Returns:
        Angles (N,) [rad] and points (N, 3) [m] from the root on, in head axes.
    """
    u = np.linspace(0.0, 1.0, _RINGS)
    phi = start_angle + turn * u**growth
    tangent = _tangent(phi)
    steps = 0.5 * (tangent[1:] + tangent[:-1]) / (_RINGS - 1)
    curve = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, 0)])
    arc = (reach + 0.004) / -curve[:, 2].min()
    return phi, curve * arc


def _tangent(phi: Array) -> Array:
    return np.column_stack([np.sin(phi), np.zeros(len(phi)), -np.cos(phi)])


def _slotted_plate(
    rng: np.random.Generator, curve: Array, phi: Array, root_thickness: float, width: float, material: Material,
    lean: float = 0.0,
) -> tuple[Piece, Array]:  # fmt: skip
    """Two tapering tines with a slot between them along a curve.

    Args:
        rng: Random generator of the tool.
        curve: Points of the curve (N, 3) [m], head axes.
        phi: Its angle to the axis of the head (N,) [rad].
        root_thickness: Half of the thickness at the root [m].
        width: Half of the width of the body [m].
        material: Material of the claw.
        lean: How much wider the slot is on the handle's side, as a share of its width; 0: upright walls.

    Returns:
        The claw and the pose of its EE, 4x4, in head axes.
    """
    n, u = _RINGS, np.linspace(0.0, 1.0, _RINGS)
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
    slot = range(first, n)
    if lean:
        claw = loft(rings) - _leaning_slot(curve[slot], away[slot], thickness[slot], gap, lean, _tangent(phi)[-1])
    else:
        tall = 2.5 * root_thickness
        corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        cutter = [
            curve[i] + tall * corners[:, :1] * away[i] + g * corners[:, 1:] * np.array([0.0, 1.0, 0.0])
            for i, g in zip(slot, gap, strict=True)
        ]
        cutter.append(cutter[-1] + 0.01 * _tangent(phi)[-1])
        claw = loft(rings) - loft(np.stack(cutter))
    tines = [
        np.stack([ring(i, *sorted((side * g, side * across[i]))) for i, g in zip(slot, gap, strict=True)])
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


def _leaning_slot(curve: Array, away: Array, thickness: Array, gap: Array, lean: float, end: Array) -> Any:
    """What is cut out for a slot that is wider on the handle's side, of two mirrored halves, so that both walls agree.

    Args:
        curve: Points of the claw's middle along the slot (K, 3) [m].
        away: Directions away from the handle there (K, 3).
        thickness: Half of the thickness there (K,) [m].
        gap: Half of the width of the slot, at half of the thickness (K,) [m].
        lean: How much wider it is on the handle's side, and narrower on the other, as a share of its width.
        end: Direction of the tips (3,).

    Returns:
        The solid; just higher than the claw, whose curve is too tight for more on its inner side.
    """
    tall = 1.2 * thickness + 0.001
    corners = np.array([[1.0, 1.0 - lean], [-1.0, 1.0 + lean], [-1.0, -1e-3], [1.0, -1e-3]])
    half = [
        curve[i] + tall[i] * corners[:, :1] * away[i] + gap[i] * corners[:, 1:] * np.array([0.0, 1.0, 0.0])
        for i in range(len(curve))
    ]
    half.append(half[-1] + 0.01 * end)
    solid = loft(np.stack(half))
    return solid + solid.mirror((0.0, 1.0, 0.0))
