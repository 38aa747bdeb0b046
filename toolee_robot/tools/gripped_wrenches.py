"""Open-ended wrenches of one size with a thick grip on the handle: what a robot's hand can hold.

The bar of a forged wrench of 13 mm is 3 to 4 mm thick. Fingers that close around it meet each other before they press
on it, so the handle gets a tube of plastic or rubber. A wrench like this is in no training data.
"""

from __future__ import annotations

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.tools.materials import PLASTIC, RUBBER, RUBBER_COLORED, STEEL_BRIGHT, STEEL_DARK, varied
from toolee_robot.tools.model import EndEffector, Handle, Tool, ToolKind, assemble
from toolee_robot.tools.solids import loft_piece, stack, superellipse
from toolee_robot.tools.wrench_heads import open_head

JAW_TURN = float(np.deg2rad(15.0))
"""Angle of the jaw against the handle [rad]: that of DIN 3110's wrenches."""
REACH = (0.110, 0.120)
"""Distance of the jaw from the middle of the grip [m]."""
GRIP_ENDS, GRIP_RADIUS = (-0.072, 0.052), (0.0105, 0.0125)
"""Ends of the grip along the handle, and its radius [m]."""


def gripped_wrench(opening: float, seed: int) -> Tool:
    """Generate a wrench with one open jaw; equal arguments give equal wrenches.

    Args:
        opening: Width of the jaw between its flats [m].
        seed: Seed of its other sizes, 0 or more.

    Returns:
        The wrench, `tool` frame [m]; its origin is the middle of the grip.
    """
    rng = np.random.default_rng([200, seed])
    steel = varied(STEEL_BRIGHT if rng.uniform() < 0.7 else STEEL_DARK, rng)
    head = open_head(rng, opening, steel)
    reach, radius = rng.uniform(*REACH), rng.uniform(*GRIP_RADIUS)
    X_tool_head = _X_tool_head(reach)
    bar_z = np.linspace(GRIP_ENDS[0] + 0.010, reach - head.join, 12)
    bar = stack(
        bar_z, np.full(12, head.radius * rng.uniform(0.42, 0.55)), np.full(12, 0.8 * head.half_thickness),
        superellipse(5.0),
    )  # fmt: skip
    grip_z = np.linspace(*GRIP_ENDS, 10)
    grip_a = np.full(10, radius) * np.array([0.8, *[1.0] * 8, 0.85])
    rubber = varied((RUBBER, RUBBER_COLORED, PLASTIC)[rng.integers(3)], rng)
    pieces = [
        loft_piece("grip", stack(grip_z, grip_a, grip_a, superellipse(2.5)), rubber, 0.12),
        loft_piece("handle", bar, steel, 0.12),
        *(piece.placed(X_tool_head) for piece in head.pieces),
    ]
    p = (X_tool_head @ [head.ee_x, 0.0, 0.0, 1.0])[:3]
    X = frame_from_axes(z=X_tool_head[:3, 2], x=np.array([0.0, 0.0, GRIP_ENDS[0]]) - p, p=p)
    ends = (EndEffector(Category.WRENCH_HEAD, X),)
    return assemble(ToolKind.OPEN_END_WRENCH, seed, pieces, ends, Handle(grip_z, grip_a, grip_a))


def _X_tool_head(reach: float) -> Array:
    """Pose of the jaw in the tool: its x along the slot, its z the nut's axis."""
    slot = np.array([np.sin(JAW_TURN), 0.0, np.cos(JAW_TURN)])
    return frame_from_axes(z=np.array([0.0, 1.0, 0.0]), x=slot, p=[0.0, 0.0, reach])
