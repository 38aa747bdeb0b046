"""Where the wood beside a nail is felt."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.station import WorkConfig

ASIDE = 0.032
"""Distance from upright nails to the touch point on the wood [m]: a face of up to 25 mm radius clears their heads."""
EDGE = 0.005
"""Distance of that point from the block's edges [m]."""
TURNS = np.deg2rad([0.0, *(sign * turn for turn in range(15, 91, 15) for sign in (1, -1))])
"""Angles from the wanted direction in which the point may lie [rad], the best first."""


def way_to_bare_wood(work: WorkConfig, wanted: Array, height: float) -> Array:
    """Find the way from over a nail to over a point where a face meets bare wood and nothing else.

    It is turned from the wanted direction where another nail is in the way, or where the face would meet its head for
    the wood, or where there is no wood.

    Args:
        work: The work, about the nail.
        wanted: Wanted direction, `base`, (3,), of any length.
        height: Height of the nail's head over the wood [m].

    Returns:
        The way in the plane of the wood, `base`, (3,) [m]; where no direction has a good point, that to the best one.
    """
    out = work.wood_normal
    towards = wanted - (wanted @ out) * out
    towards /= np.linalg.norm(towards)
    across = np.cross(out, towards)
    others = [nail.X_base_nail(h)[:3, 3] for nail in work.others for h in (0.0, nail.nail_protrusion)]
    X_block_base, half = inverse(work.X_base_block), np.array(work.block_size[:2]) / 2
    best, most = np.zeros(3), -np.inf
    for turn in TURNS:
        aside = np.cos(turn) * towards + np.sin(turn) * across
        # A nail that leans has its foot nearer to there, or farther from it, than its head.
        way = (ASIDE + max(0.0, -height * float(aside @ work.nail_axis))) * aside
        steps = work.p_base_entry + np.linspace(0.0, 1.0, 9)[1:, None] * way
        free = [np.linalg.norm(np.cross(steps - end, out), axis=1).min() - ASIDE for end in others]
        wood = np.min(half - np.abs(transform_points(X_block_base, steps[-1:])[0, :2])) - EDGE
        room = float(min([wood, *free]))
        if room > most:
            best, most = way, room
        if room >= 0.0:
            break
    return np.asarray(best)
