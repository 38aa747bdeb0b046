"""Hammers, mallets and meat tenderisers: a head on a handle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import frame_from_axes
from toolee_robot.tools.claws import claw_head, hanging_claw_head
from toolee_robot.tools.hammer_heads import Head, ball_peen_head, club_head, cross_peen_head, sledge_head
from toolee_robot.tools.handles import hammer_handle, turned_handle
from toolee_robot.tools.mallet_heads import mallet_head, tenderiser_head, wooden_mallet_head
from toolee_robot.tools.model import EndEffector, Tool, ToolKind, assemble


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
