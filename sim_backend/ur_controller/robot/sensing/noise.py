"""Reproducible random numbers, drawn in blocks, since single draws would cost a tick of 2 ms too much."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolee_robot.frames import Array

BLOCK = 1024


class Noise:
    """Standard normal vectors of six.

    Args:
        seed: Seed; equal seeds give equal vectors.
    """

    def __init__(self, seed: int | Sequence[int]) -> None:
        self._rng = np.random.default_rng(seed)
        self._block, self._next = self._rng.standard_normal((BLOCK, 6)), 0

    def vector(self) -> Array:
        """The next vector, (6,)."""
        if self._next == BLOCK:
            self._block, self._next = self._rng.standard_normal((BLOCK, 6)), 0
        self._next += 1
        return np.asarray(self._block[self._next - 1])
