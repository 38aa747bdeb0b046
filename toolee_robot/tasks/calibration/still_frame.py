"""One image of a scene that stands still, with less noise than a frame has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.hal import RgbdCamera

FRAMES = 5
"""Number of frames that are averaged."""


def mean_frame(camera: RgbdCamera, count: int = FRAMES) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Average frames of a scene that stands still.

    Args:
        camera: The camera.
        count: Number of frames.

    Returns:
        Mean image, (H, W, 3) uint8, and median depth, (H, W) [m], NaN where no frame has one.

    Raises:
        DeviceError: The camera does not answer.
    """
    frames = [camera.read() for _ in range(count)]
    rgb = np.rint(np.mean([frame.rgb for frame in frames], axis=0)).astype(np.uint8)
    depths = np.stack([np.where(frame.depth > 0.0, frame.depth, np.nan) for frame in frames])
    known = np.isfinite(depths).any(axis=0)
    median = np.full(depths.shape[1:], np.nan, np.float32)
    median[known] = np.nanmedian(depths[:, known], axis=0)
    return rgb, median
