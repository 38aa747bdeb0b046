"""Textures, rooms and backdrops have numbers; every fifth is held out for the test split."""

from __future__ import annotations

import numpy as np

TEXTURES, ROOMS, BACKDROPS = 1000, 1000, 1000


def draw(rng: np.random.Generator, split: str, count: int) -> int:
    """A number under `count` (a multiple of 5) that belongs to the split: every fifth one is held out."""
    five = 5 * int(rng.integers(count // 5))
    return five + 4 if split == "test" else five + int(rng.integers(4))
