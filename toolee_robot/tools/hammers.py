"""Hammer handles: wood, fibreglass and steel, straight or slightly curved, round, oval or waisted; turned handles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.tools.claws import claw_head, hanging_claw_head
from toolee_robot.tools.hammer_heads import (
    Head,
    ball_peen_head,
    club_head,
    cross_peen_head,
    mallet_head,
    sledge_head,
    tenderiser_head,
    wooden_mallet_head,
)
from toolee_robot.tools.materials import FIBERGLASS, RUBBER, RUBBER_COLORED, WOOD, Material, steel, varied
from toolee_robot.tools.model import EndEffector, Handle, Tool, ToolKind, assemble
from toolee_robot.tools.solids import Piece, loft_piece, stack, superellipse


@dataclass(frozen=True, eq=False)
class HammerHandle:
    """A hammer handle in the `tool` frame.

    Attributes:
        pieces: Overlapping solids [m].
        handle: Grippable section.
        x_head: x of the centre line at the head [m].
        slope: Slope dx/dz of the centre line at the head.
    """

    pieces: list[Piece]
    handle: Handle
    x_head: float
    slope: float


def hammer_handle(
    rng: np.random.Generator, *, z_head: float, reach: float, eye: tuple[float, float], free: float, butt: float,
    style: str,
) -> HammerHandle:  # fmt: skip
    """Generate a handle from z = -butt to z = z_head + reach.

    Args:
        rng: Random generator of the tool.
        z_head: z of the centre of the head [m].
        reach: Length of the handle beyond the centre of the head [m].
        eye: Half-widths [m] along x and y of the section inside the head.
        free: Half-height of the head [m]; the grippable section ends at z_head - free.
        butt: Distance of the butt from the grip centre [m].
        style: "wood", "fiberglass" or "steel".

    Returns:
        The handle, in the `tool` frame.
    """
    bend = rng.uniform(0.0, 0.010) / z_head**2 * (rng.uniform() < 0.35) * rng.choice([-1.0, 1.0])
    top = z_head + reach
    grip_b = rng.uniform(0.0115, 0.0165)
    grip_a = grip_b * rng.uniform(1.0, 1.35)
    exponent = float(rng.choice([2.0, 2.0, 2.4, 3.0]))
    entry = z_head - free
    if style == "wood":
        swell = rng.uniform(1.0, 1.18)
        waist = rng.uniform(0.72, 0.95)
        knots = [-butt, -butt + 0.02, 0.0, 0.45 * entry, entry - 0.02, entry + 0.004, top]
        a = [grip_a * swell, grip_a * swell, grip_a, grip_a * waist, 0.5 * (grip_a * waist + eye[0]), *[eye[0]] * 2]
        b = [grip_b * swell, grip_b * swell, grip_b, grip_b * waist, 0.5 * (grip_b * waist + eye[1]), *[eye[1]] * 2]
        rounding = rng.uniform(0.002, 0.006)
        shaft, z, wa, wb = _shaft("handle", varied(WOOD, rng), knots, a, b, bend, exponent, rounding)
        handle = Handle(z, wa, wb)
        pieces = [shaft]
    else:
        thin_b = grip_b * rng.uniform(0.5, 0.72)
        thin_a = min(thin_b * rng.uniform(1.0, 1.8), 0.72 * grip_a)
        knots = [-butt + 0.006, 0.0, 0.5 * entry, entry - 0.02, entry + 0.004, top]
        a = [thin_a, thin_a, thin_a, 0.5 * (thin_a + eye[0]), eye[0], eye[0]]
        b = [thin_b, thin_b, thin_b, 0.5 * (thin_b + eye[1]), eye[1], eye[1]]
        material = steel(rng) if style == "steel" else varied(FIBERGLASS, rng)
        shaft, z, wa, wb = _shaft("shaft", material, knots, a, b, bend, exponent, 0.001)
        grip, gz, ga, gb = _grip(rng, butt, entry, grip_a, grip_b, bend, exponent)
        above = z > gz[-1]
        handle = Handle(
            np.concatenate([gz, z[above]]), np.concatenate([ga, wa[above]]), np.concatenate([gb, wb[above]])
        )
        pieces = [grip, shaft]
    inside = handle.z <= entry
    handle = Handle(handle.z[inside], handle.radii_x[inside], handle.radii_y[inside])
    return HammerHandle(pieces, handle, bend * z_head**2, 2 * bend * z_head)


def turned_handle(
    rng: np.random.Generator, *, z_head: float, reach: float, eye: tuple[float, float], free: float, butt: float,
    material: Material,
) -> HammerHandle:  # fmt: skip
    """Generate a round handle with a lathe's profile: dowel, swell or taper, often a ball at the butt, beads and coves.

    Args:
        rng: Random generator of the tool.
        z_head: z of the centre of the head [m].
        reach: Length of the handle beyond the centre of the head [m]; every second one ends inside the head.
        eye: Half-widths [m] along x and y of the section inside the head.
        free: Half-height of the head [m]; the grippable section ends at z_head - free.
        butt: Distance of the butt from the grip centre [m].
        material: Its material.

    Returns:
        The handle, in the `tool` frame.
    """
    top = z_head + reach if rng.uniform() < 0.5 else z_head + 0.3 * free
    entry = z_head - free
    r = rng.uniform(0.0085, 0.0135)
    widths = {
        "dowel": [0.9, 1.0, 1.0, 1.0, 1.0],
        "swell": [0.75, 0.95, 1.1, 0.85, 0.65],
        "taper": [1.0, 1.15, 1.0, 0.85, 0.75],
        "waisted": [0.95, 1.1, 0.8, 0.95, 0.7],
    }[str(rng.choice(["dowel", "swell", "taper", "waisted"]))]
    knots = [-butt, -butt + 0.015, 0.0, 0.6 * entry, entry - 0.008, entry + 0.002, top]
    radii = PchipInterpolator(knots, [*(r * np.array(widths)), eye[0], eye[0]])
    heights = [np.linspace(-butt, top, 40), np.array([0.002 - butt])]
    features: list[tuple[float, float, float]] = []  # z, height and half-length of beads and, negative, of coves [m]
    if rng.uniform() < 0.45:
        features.append((-butt + 0.010, rng.uniform(0.15, 0.4) * r, 0.009))
    for _ in range(int(rng.integers(0, 4))):
        depth = rng.uniform(0.0008, 0.0022) * rng.choice([-1.0, 1.0])
        features.append((rng.uniform(0.03 - butt, entry - 0.012), depth, rng.uniform(0.002, 0.004)))
    heights += [np.linspace(at - 1.5 * s, at + 1.5 * s, 9) for at, _, s in features]
    z = np.unique(np.concatenate(heights))
    z = z[(z >= -butt) & (z <= top)]
    z = z[np.concatenate([[True], np.diff(z) > 1e-5])]
    a = radii(z) + sum(
        (h * np.exp(-(((z - at) / s) ** 2)) * (z < entry - 0.004) for at, h, s in features), np.zeros(len(z))
    )
    a[0] *= rng.uniform(0.55, 0.85)
    handle = loft_piece("handle", stack(z, a), material, 0.14)
    inside = z <= entry
    return HammerHandle([handle], Handle(z[inside], a[inside], a[inside]), 0.0, 0.0)


def _shaft(
    label: str, material: Material, knots: list[float], a: list[float], b: list[float], bend: float, exponent: float,
    rounding: float,
) -> tuple[Piece, Array, Array, Array]:  # fmt: skip
    z = np.unique(np.concatenate([np.linspace(knots[0], knots[-1], 22), [knots[0] + rounding]]))
    wa, wb = PchipInterpolator(knots, a)(z), PchipInterpolator(knots, b)(z)
    wa[0] -= rounding * 0.8
    wb[0] -= rounding * 0.8
    rings = stack(z, wa, wb, superellipse(exponent), bend * z * np.abs(z))
    return loft_piece(label, rings, material), z, wa, wb


def _grip(
    rng: np.random.Generator, butt: float, entry: float, a: float, b: float, bend: float, exponent: float
) -> tuple[Piece, Array, Array, Array]:
    """A rubber sleeve from the butt on: flared end, waist or swell, optional rings, flared or tapered front."""
    end = min(rng.uniform(0.045, 0.085), entry - 0.03)
    flare = rng.uniform(1.0, 1.25)
    front = rng.uniform(0.8, 1.2)
    waist = rng.uniform(0.9, 1.1)
    knots = [-butt, -butt + 0.012, -butt + 0.03, 0.0, end - 0.02, end]
    ka = np.array([flare, flare, 1.02, waist, 1.0, front])
    z = np.unique(np.concatenate([np.linspace(-butt, end, 30), [-butt + 0.003, end - 0.003]]))
    scale = PchipInterpolator(knots, ka)(z)
    if rng.uniform() < 0.5:
        waves = np.sin(2 * np.pi * rng.integers(4, 9) * (z + butt) / (end + butt))
        scale = scale - rng.uniform(0.02, 0.06) * np.maximum(0.0, waves)
    scale[[0, -1]] -= rng.uniform(0.1, 0.25)
    # At least as square as the section of the shaft, so that the shaft stays inside the sleeve.
    rings = stack(
        z, a * scale, b * scale, superellipse(max(exponent, float(rng.choice([2.0, 2.4, 3.0])))), bend * z * np.abs(z)
    )
    material = varied(RUBBER if rng.uniform() < 0.6 else RUBBER_COLORED, rng)
    return loft_piece("grip", rings, material, 0.12), z, a * scale, b * scale


@dataclass(frozen=True)
class HammerShape:
    """Parameters of a kind of hammer."""

    head: Callable[[np.random.Generator], Head]
    """Generator of the head."""
    length: tuple[float, float] = (0.23, 0.36)
    """Range of the length from the butt to the axis of the head [m]."""
    wooden: float = 0.0
    """Probability of forcing a wooden handle; otherwise wood, fibreglass and steel are equally likely."""
    butt: tuple[float, float] = (0.070, 0.095)
    """Range of the distance of the butt from the grip centre [m]."""
    mass: tuple[float, float] = (0.3, 1.5)
    """Range of the mass [kg]."""


def make_hammer(shape: HammerShape, kind: ToolKind, seed: int, rng: np.random.Generator) -> Tool:
    """Generate a hammer; a draw with a mass out of the kind's range is rejected and repeated, up to 20 times.

    Args:
        shape: Parameters of the kind.
        kind: Kind of the tool.
        seed: Seed that the tool is named after.
        rng: Random generator of the tool; equal states give equal tools.

    Returns:
        The hammer, `tool` frame [m].

    Raises:
        AssertionError: No draw has a mass in the range.
    """
    for _ in range(20):
        tool = _draw(shape, kind, seed, rng)
        if tool.mass_within(*shape.mass):
            return tool
    raise AssertionError(f"no plausible mass for {kind} {seed}: {tool.mass:.2f} kg")


def _draw(shape: HammerShape, kind: ToolKind, seed: int, rng: np.random.Generator) -> Tool:
    head = shape.head(rng)
    styles = ["wood"] if shape.wooden > 0 and rng.uniform() < shape.wooden else ["wood", "fiberglass", "steel"]
    total = rng.uniform(*shape.length)
    butt = rng.uniform(*shape.butt)
    z_head = total - butt
    proud = rng.uniform(-0.001, 0.004)
    reach = head.half_height + proud
    if head.turned is None:
        shaft = hammer_handle(
            rng, z_head=z_head, reach=reach, eye=head.eye, free=head.half_height, butt=butt,
            style=str(rng.choice(styles)),
        )  # fmt: skip
    else:
        shaft = turned_handle(
            rng, z_head=z_head, reach=reach, eye=head.eye, free=head.half_height, butt=butt, material=head.turned
        )
    most = 3.0 if head.turned is None else 1.0
    tilt = np.deg2rad(rng.uniform(-most, most)) - np.arctan(shaft.slope)
    X_tool_head = frame_from_axes(
        z=np.array([np.cos(tilt), 0.0, np.sin(tilt)]), x=np.array([0.0, 0.0, -1.0]), p=[shaft.x_head, 0.0, z_head]
    )
    pieces = [piece.placed(X_tool_head) for piece in head.pieces]
    ees = tuple(EndEffector(category, X_tool_head @ X) for category, X in head.ees)
    return assemble(kind, seed, [*pieces, *shaft.pieces], ees, shaft.handle)


CLAW_HAMMER = HammerShape(claw_head)
BALL_PEEN_HAMMER = HammerShape(ball_peen_head)
CROSS_PEEN_HAMMER = HammerShape(cross_peen_head)
CLUB_HAMMER = HammerShape(club_head, length=(0.20, 0.30))
MALLET = HammerShape(mallet_head, wooden=0.6)
HANGING_CLAW_HAMMER = HammerShape(hanging_claw_head)
WOODEN_MALLET = HammerShape(wooden_mallet_head, length=(0.145, 0.30), butt=(0.055, 0.075), mass=(0.07, 0.7))
MEAT_TENDERISER = HammerShape(tenderiser_head, length=(0.165, 0.27), butt=(0.055, 0.075), mass=(0.1, 1.3))
# Handles from a club hammer's to a sledge hammer's (DIN 1042: from 0.6 m); who holds one may hold it far from its butt.
SLEDGE_HAMMER = HammerShape(sledge_head, length=(0.28, 0.85), wooden=0.5, butt=(0.08, 0.14), mass=(1.2, 5.8))
