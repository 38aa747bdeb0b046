"""Table of smooth three-dimensional noise, the basis of the procedural textures."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import warp as wp
from scipy.ndimage import gaussian_filter

from toolee_robot.render.device import DeviceArray, put
from toolee_robot.render.kernels.texture import TABLE_SIZE

_BLUR = 16.0 / 3
"""Standard deviation of the blur [cells]; features have a size of about 16 cells."""


@lru_cache
def noise_table(device: str) -> DeviceArray:
    """(128^3,) float32: tileable noise, uniform in [0, 1] by rank, the same in every process."""
    rng = np.random.Generator(np.random.PCG64(20240717))
    smooth = gaussian_filter(rng.standard_normal((TABLE_SIZE,) * 3).astype(np.float32), _BLUR, mode="wrap")
    smooth /= smooth.std()
    # Normal to uniform by the logistic approximation of the normal distribution function.
    table = (1.0 / (1.0 + np.exp(-1.702 * smooth))).reshape(-1).astype(np.float32)
    return put(table, wp.float32, device)
