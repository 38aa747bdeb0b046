"""Hammer handles: wood, fibreglass and steel, straight or slightly curved, round, oval or waisted; turned handles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from toolee_robot.frames import Array
from toolee_robot.tools.materials import FIBERGLASS, RUBBER, RUBBER_COLORED, WOOD, Material, steel, varied
from toolee_robot.tools.model import Handle
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
