"""Open-end, combination, adjustable, box and socket wrenches: heads on handles."""

from __future__ import annotations

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.tools.materials import PLASTIC, RUBBER, RUBBER_COLORED, STEEL_BRIGHT, STEEL_DARK, Material, varied
from toolee_robot.tools.model import EndEffector, Handle, Tool, ToolKind, assemble
from toolee_robot.tools.solids import (
    Convex,
    Piece,
    extrude,
    hexagon,
    loft,
    loft_piece,
    move,
    place,
    stack,
    superellipse,
)
from toolee_robot.tools.wrench_heads import WrenchHead, adjustable_head, open_head, ring_head


def make_wrench(kind: ToolKind, seed: int, rng: np.random.Generator) -> Tool:
    """Generate a wrench for nuts of 8 to 32 mm (adjustable ones: opening of 4 to 37 mm).

    Args:
        kind: Kind of the wrench.
        seed: Seed that the tool is named after.
        rng: Random generator of the tool; equal states give equal tools.

    Returns:
        The wrench, `tool` frame [m].
    """
    size = rng.uniform(0.008, 0.032)
    material = varied(STEEL_BRIGHT if rng.uniform() < 0.7 else STEEL_DARK, rng)
    if kind is ToolKind.SOCKET_WRENCH:
        return _socket_wrench(seed, rng, rng.uniform(0.008, 0.021), material)
    length = float(np.clip(rng.uniform(7.0, 11.0) * size + 0.05, 0.11, 0.33))
    angle = np.deg2rad(rng.choice([0.0, 15.0, 15.0, rng.uniform(0.0, 22.5)]))
    far: WrenchHead | None = None
    far_angle = near_pitch = far_pitch = 0.0
    match kind:
        case ToolKind.OPEN_END_WRENCH:
            near = open_head(rng, size, material)
            if rng.uniform() < 0.65:
                far, far_angle = open_head(rng, size * rng.uniform(0.78, 1.0), material), angle
        case ToolKind.COMBINATION_WRENCH:
            near, far = open_head(rng, size, material), ring_head(rng, size, material)
            far_pitch = np.deg2rad(rng.uniform(0.0, 15.0))
        case ToolKind.BOX_WRENCH:
            near = ring_head(rng, size, material)
            far = ring_head(rng, size * rng.uniform(0.8, 1.0), material) if rng.uniform() < 0.8 else None
            angle = 0.0
            near_pitch = far_pitch = np.deg2rad(rng.uniform(0.0, 15.0))
        case _:
            scale = rng.uniform(0.55, 1.25)
            near = adjustable_head(rng, material, scale)
            length = 0.09 + 0.15 * scale * rng.uniform(0.85, 1.15)
            angle = np.deg2rad(rng.uniform(10.0, 22.5))
    heads = [(near, _X_tool_head(near, 0.5 * length, angle, 1.0, near_pitch))]
    if far:
        heads.append((far, _X_tool_head(far, -0.5 * length, far_angle, -1.0, far_pitch)))
    if kind is ToolKind.EYE_ADJUSTABLE_WRENCH:
        pieces, handle = _eye_handle(rng, near, length, material)
    else:
        pieces, handle = _handle(kind, rng, near, far, length, material)
    ends = (-0.5 * length - (far.radius if far else 0.0), 0.5 * length + near.radius)
    ees = []
    for (head, X_tool_head), opposite_end in zip(heads, ends, strict=False):
        pieces += [piece.placed(X_tool_head) for piece in head.pieces]
        p = (X_tool_head @ [head.ee_x, 0.0, 0.0, 1.0])[:3]
        X = frame_from_axes(z=X_tool_head[:3, 2], x=np.array([0.0, 0.0, opposite_end]) - p, p=p)
        ees.append(EndEffector(Category.WRENCH_HEAD, X))
    return assemble(kind, seed, pieces, tuple(ees), handle)


def _X_tool_head(head: WrenchHead, z: float, turn: float, side: float, pitch: float) -> Array:
    """Pose of a head in the `tool` frame.

    Args:
        head: The head.
        z: Height of the pivot [m].
        turn: Rotation about the axis of the nut, tool y [rad].
        side: 1 or -1: the head's x lies along side * tool z before the rotations.
        pitch: Rotation out of the plane of the handle [rad].
    """
    c, s, cp, sp = np.cos(turn), np.sin(turn), np.cos(pitch), np.sin(pitch)
    out, normal = np.array([side * s, 0.0, side * c]), np.array([0.0, 1.0, 0.0])
    x, n = cp * out + sp * normal, cp * normal - sp * out
    R = np.column_stack([x, np.cross(n, x), n])
    return transform(R, np.array([0.0, 0.0, z]) - head.pivot_x * x)


def _chord(head: WrenchHead) -> float:
    """Half the width of the head's outline where the handle ends [m]."""
    return float(0.95 * np.sqrt(head.radius**2 - min(head.join, 0.9 * head.radius) ** 2))


def _handle(
    kind: ToolKind, rng: np.random.Generator, near: WrenchHead, far: WrenchHead | None, length: float,
    material: Material,
) -> tuple[list[Piece], Handle]:  # fmt: skip
    """Generate a waisted and tapered bar between two heads, or from one head to a rounded butt.

    Optional are sunk panels on both flat sides, a hanging hole and a sleeve.

    Args:
        kind: Kind of the tool.
        rng: Random generator of the tool.
        near: Head at the upper end.
        far: Head at the lower end; None: a rounded butt.
        length: Distance between the ends [m].
        material: Material of the bar.
    """
    top, bottom = 0.5 * length - near.join, -0.5 * length + (far.join if far else 0.0)
    adjustable = kind is ToolKind.ADJUSTABLE_WRENCH
    half_y = min(near.half_thickness, far.half_thickness if far else 1.0) * rng.uniform(0.55, 0.9)
    widest = near.radius * (rng.uniform(0.8, 0.95) if adjustable else rng.uniform(0.42, 0.62))
    taper = rng.uniform(0.7, 1.0) if adjustable else rng.uniform(0.8, 1.05)
    u = np.linspace(0.0, 1.0, 20)
    z = bottom + (top - bottom) * u
    flare = 1.0 + rng.uniform(0.0, 0.35) * (np.clip((u - 0.85) / 0.15, 0, 1) ** 2) * (not adjustable)
    if far:
        flare = flare + rng.uniform(0.0, 0.35) * np.clip((0.15 - u) / 0.15, 0, 1) ** 2
    a = widest * (taper + (1 - taper) * u) * (1.0 - rng.uniform(0.0, 0.2) * np.sin(np.pi * u)) * flare
    if not adjustable:  # keep the ends inside the outlines of the heads
        a = a - max(a[-1] - _chord(near), 0.0) * np.clip((u - 0.5) / 0.5, 0, 1)
    if far:
        a = a - max(a[0] - _chord(far), 0.0) * np.clip((0.5 - u) / 0.5, 0, 1)
    rounding = np.ones(20)
    if far is None:
        rounding[0] = rng.uniform(0.5, 0.9)
    exponent = float(rng.choice([2.0, 3.0, 5.0, 8.0]))
    rings = stack(z, a * rounding, half_y * np.sqrt(rounding), superellipse(exponent))
    bar = loft(rings)
    lay = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))
    if exponent > 4 and rng.uniform() < 0.5:
        panel = superellipse(4.0, 32) * [0.62 * a.min(), rng.uniform(0.25, 0.38) * (top - bottom)]
        panel[:, 1] -= 0.5 * (bottom + top)
        depth = rng.uniform(0.12, 0.35) * half_y
        for low, high in ((-2 * half_y, depth - half_y), (half_y - depth, 2 * half_y)):
            bar = bar - place(extrude(panel, low, high), lay)
    if far is None and rng.uniform() < 0.75:
        hole = superellipse(2.0, 24) * rng.uniform(0.35, 0.5) * a[1] - [0.0, bottom + 1.1 * a[1]]
        bar = bar - place(extrude(hole, -2 * half_y, 2 * half_y), lay)
    pieces = [Piece("handle", bar, material, (Convex(rings, 0.12),))]
    width, depth_y = a * rounding, np.full(20, half_y)
    if far is None and adjustable and rng.uniform() < 0.4:
        covered = np.linspace(bottom - 0.003, bottom + 0.55 * (top - bottom), 10)
        scale = np.array([0.8, *[1.0] * 8, 0.85])
        sleeve_a, sleeve_b = (np.interp(covered, z, a) + 0.002) * scale, (half_y + 0.002) * scale
        cover = varied((RUBBER, RUBBER_COLORED, PLASTIC)[rng.integers(3)], rng)
        sleeve = stack(covered, sleeve_a, sleeve_b, superellipse(max(exponent, 3.0)))
        pieces.insert(0, loft_piece("grip", sleeve, cover, 0.12))
        above = z > covered[-1]
        z = np.concatenate([covered, z[above]])
        width, depth_y = np.concatenate([sleeve_a, width[above]]), np.concatenate([sleeve_b, depth_y[above]])
    return pieces, Handle(z, width, depth_y)


def _eye_handle(
    rng: np.random.Generator, near: WrenchHead, length: float, material: Material
) -> tuple[list[Piece], Handle]:
    """Generate the handle of an adjustable wrench that ends in an eye to hang it by, which is no end effector.

    The holes are round, oblong or drop-shaped and half as wide as the end or more, which is estimated, not measured.

    Args:
        rng: Random generator of the tool.
        near: Head at the upper end.
        length: Distance of the butt from the head's pivot [m].
        material: Material of the bar.
    """
    top, bottom = 0.5 * length - near.join, -0.5 * length
    half_y = near.half_thickness * rng.uniform(0.65, 0.95)
    end = near.radius * rng.uniform(0.8, 1.1)
    stretch = rng.uniform(1.0, 1.5)
    z = bottom + np.unique(np.concatenate([np.linspace(0.0, top - bottom, 24), end * stretch * np.linspace(0, 2, 13)]))
    z = z[np.concatenate([[True], np.diff(z) > 1e-4])]
    u = (z - bottom) / (top - bottom)
    bar = near.radius * (rng.uniform(0.5, 0.72) + rng.uniform(0.1, 0.35) * u)
    centre = bottom + end * stretch
    eye = end * np.sqrt(np.clip(1.0 - ((z - centre) / (end * stretch)) ** 2, 0.0, 1.0))
    a = np.where(z < centre, np.maximum(eye, 0.35 * end), np.maximum(eye, bar))
    exponent = float(rng.choice([3.0, 5.0, 8.0]))
    rings = stack(z, a, half_y, superellipse(exponent))
    solid = loft(rings)
    lay = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
    radius = end * rng.uniform(0.45, 0.66)
    hole = superellipse(2.0, 32) * radius + np.array([0.0, centre])
    match rng.choice(["round", "oblong", "drop"]):
        case "oblong":
            hole[hole[:, 1] > centre, 1] += (stretch - 0.85) * end
        case "drop":
            hole[:, 0] *= np.clip(1.0 - 0.8 * (hole[:, 1] - centre) / radius, 0.25, 1.0)
            hole[hole[:, 1] > centre, 1] += 0.6 * radius
    solid = solid - place(extrude(hole, -2 * half_y, 2 * half_y), lay)
    if rng.uniform() < 0.7:
        low = float(hole[:, 1].max()) + 0.5 * end
        panel = superellipse(6.0, 32) * [0.62 * bar.min(), 0.5 * (top - 0.006 - low)]
        panel += [0.0, 0.5 * (top - 0.006 + low)]
        depth = rng.uniform(0.15, 0.4) * half_y
        for low_y, high_y in ((-2 * half_y, depth - half_y), (half_y - depth, 2 * half_y)):
            solid = solid - place(extrude(panel, low_y, high_y), lay)
    handle = Handle(z, a, np.full(len(z), half_y))
    return [Piece("handle", solid, material, (Convex(rings, 0.12),))], handle


def _socket_wrench(seed: int, rng: np.random.Generator, size: float, material: Material) -> Tool:
    """A ratchet with a socket: the axis of the nut is perpendicular to the handle, the EE lies inside the socket."""
    length = rng.uniform(0.14, 0.26)
    outer = size * rng.uniform(0.66, 0.75) + 0.0008
    drive, drive_half = rng.uniform(0.0125, 0.0190), rng.uniform(0.006, 0.010)
    depth, hole = rng.uniform(0.020, 0.036), rng.uniform(0.008, 0.013)
    gap = rng.uniform(0.0, 0.004)
    X_tool_head = np.array(
        [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.5 * length], [0.0, 0.0, 0.0, 1.0]]
    )
    drum = stack(
        drive_half * np.array([-1.0, -0.75, 0.75, 1.0]), drive * np.array([0.9, 1.0, 1.0, 0.9]), None,
        superellipse(2.0, 40),
    )  # fmt: skip
    start, mouth = drive_half + gap, drive_half + gap + depth
    root = min(outer, rng.uniform(0.008, 0.011))
    cup = stack(
        np.array([start, mouth - hole - 0.003, mouth - hole, mouth - 0.0008, mouth]),
        np.array([root, root, outer, outer, outer - 0.0008]), None, superellipse(2.0, 40),
    )  # fmt: skip
    socket = loft(cup) - extrude(hexagon(size), mouth - hole, mouth + 0.01)
    stem = stack(np.array([0.0, start + 0.004]), 0.0062)
    shaft_radius, grip_radius = rng.uniform(0.0048, 0.0078), rng.uniform(0.0078, 0.015)
    z = np.linspace(-0.5 * length, 0.5 * length - 0.5 * drive, 24)
    u = (z - z[0]) / (z[-1] - z[0])
    grip_end = rng.uniform(0.4, 0.7)
    a = np.where(u < grip_end, grip_radius, shaft_radius)
    a[0] *= 0.8
    a[-3:] = np.linspace(shaft_radius, min(0.75 * drive, 1.6 * shaft_radius), 3)
    section = superellipse(float(rng.choice([2.0, 3.0])))
    flat = min(1.0, 0.95 * drive_half / float(a[-1]))
    b = a * np.where(u > 0.85, flat, 1.0)
    bare = rng.uniform() < 0.45
    sleeve_material = varied((RUBBER, RUBBER_COLORED, PLASTIC)[rng.integers(3)], rng)
    bar_a = a if bare else np.minimum(a, shaft_radius * 1.6)
    bar_b = np.minimum(b, bar_a)
    pieces = [
        loft_piece("handle", stack(z, bar_a, bar_b, section), material, 0.12),
        loft_piece("ratchet", drum, material).placed(X_tool_head),
        loft_piece("drive", stem, material).placed(X_tool_head),
        Piece("socket", socket, varied(STEEL_BRIGHT if rng.uniform() < 0.7 else STEEL_DARK, rng), (Convex(cup, 0.04),))
        .placed(X_tool_head),
    ]  # fmt: skip
    if not bare:
        soft = u < grip_end
        sleeve_z, radii = z[soft] - 0.002, np.maximum(a[soft], bar_a[soft] + 0.001)
        pieces.insert(0, loft_piece("grip", stack(sleeve_z, radii, None, section), sleeve_material, 0.12))
        # The grippable surface is the sleeve and, above it, the bar.
        z, a, b = (
            np.concatenate([sleeve, bar[~soft]]) for sleeve, bar in ((sleeve_z, z), (radii, bar_a), (radii, bar_b))
        )
    p = move(np.array([[0.0, 0.0, mouth - 0.5 * hole]]), X_tool_head)[0]
    X = frame_from_axes(z=X_tool_head[:3, 2], x=np.array([0.0, 0.0, z[0]]) - p, p=p)
    ee = EndEffector(Category.WRENCH_HEAD, X)
    return assemble(ToolKind.SOCKET_WRENCH, seed, pieces, (ee,), Handle(z, a, b))
