"""The place of the nail's head, from touches with a known tip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform_points

MIN_TOUCHES = 3
"""Fewest touches."""
LARGEST_SPREAD = 2e-3
"""Distance of a touch from the median of all above which it was on something else [m]."""


@dataclass(frozen=True)
class LocatedNail:
    """A nail's head.

    Attributes:
        head: Middle of its top in `base`, (3,) [m].
        spread: Largest distance of a touch from it [m].
    """

    head: tuple[float, float, float]
    spread: float


def locate_nail(Xs_base_flange: Sequence[Array], p_flange_tip: Array) -> LocatedNail:
    """Locate the head: the median of the touches.

    Args:
        Xs_base_flange: Poses of the flange with the tip on the head's middle, (4, 4) each.
        p_flange_tip: The tip in the flange, (3,) [m].

    Returns:
        The nail.

    Raises:
        UserError: There are too few touches (`user.nail_few_touches`), or they disagree (`user.nail_spread`).
    """
    if len(Xs_base_flange) < MIN_TOUCHES:
        raise UserError(f"{len(Xs_base_flange)} touches: give {MIN_TOUCHES} or more", code="user.nail_few_touches")
    p = transform_points(np.asarray(Xs_base_flange), p_flange_tip[None])[:, 0]
    x, y, z = np.median(p, axis=0).tolist()
    off = np.linalg.norm(p - [x, y, z], axis=1)
    if off.max() > LARGEST_SPREAD:
        raise UserError(
            f"touch {int(np.argmax(off)) + 1} is {off.max() * 1e3:.1f} mm from the others: touch the middle of the "
            "head again, and check the tip with `toolee calibrate mount`",
            code="user.nail_spread",
        )
    return LocatedNail((x, y, z), float(off.max()))
