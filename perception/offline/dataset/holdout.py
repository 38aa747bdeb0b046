"""Numbering of textures, rooms and backdrops; each fifth number is held out for the test split."""

from __future__ import annotations

import numpy as np

TEXTURES, ROOMS, BACKDROPS = 1000, 1000, 1000
"""Numbers of textures, rooms and backdrops in both splits."""


def draw(rng: np.random.Generator, split: str, count: int) -> int:
    """Draw a number of a split; each fifth number belongs to "test".

    Args:
        rng: Random generator.
        split: "train" or "test".
        count: Upper bound, excluded; a multiple of 5.

    Returns:
        The number.
    """
    five = 5 * int(rng.integers(count // 5))
    return five + 4 if split == "test" else five + int(rng.integers(4))
