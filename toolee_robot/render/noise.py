"""Smooth three-dimensional noise as a table: the base of every procedural texture."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter

from toolee_robot.frames import Array
from toolee_robot.render.mesh import FloatArray

_SIZE = 128
_FEATURE = 16.0
"""Table cells a unit of noise coordinates: features are about one unit large."""


@lru_cache(maxsize=1)
def _table() -> FloatArray:
    """(128^3,) tileable noise, uniform in [0, 1] by rank, the same in every process."""
    rng = np.random.Generator(np.random.PCG64(20240717))
    smooth = gaussian_filter(rng.standard_normal((_SIZE,) * 3).astype(np.float32), _FEATURE / 3, mode="wrap")
    smooth /= smooth.std()
    # Normal to uniform by the logistic approximation of the normal distribution function.
    return np.ascontiguousarray((1.0 / (1.0 + np.exp(-1.702 * smooth))).reshape(-1), np.float32)


def noise(points: FloatArray | Array) -> FloatArray:
    """(N,) in [0, 1] at points (3, N) in noise units; features about one unit large, period 8 units."""
    cells = points * np.float32(_FEATURE)
    i, j, k = np.floor(cells, out=cells).astype(np.int32) & (_SIZE - 1)  # a power of two
    return _table().take((i * _SIZE + j) * _SIZE + k)


def fractal(points: FloatArray | Array) -> FloatArray:
    """(N,) in [0, 1]: two octaves of `noise`."""
    return np.float32(0.65) * noise(points) + np.float32(0.35) * noise(np.float32(2.7) * points)
