"""A picture of a frame for a person: colour and depth side by side."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from toolee_robot.runtime.files import write_atomic
from toolee_robot.types import RgbdFrame


def write_picture(path: Path, frame: RgbdFrame) -> None:
    """Write a PNG of a frame: its colour, and its depth from near (red) to far (blue), unknown in black.

    Args:
        path: The file; its folder exists.
        frame: The frame.

    Raises:
        UserError: The file cannot be written.
    """
    known = np.isfinite(frame.depth) & (frame.depth > 0)
    near, far = np.quantile(frame.depth[known], [0.01, 0.99]) if known.any() else (0.0, 1.0)
    share = np.clip((np.nan_to_num(frame.depth) - near) / max(far - near, 1e-6), 0, 1)
    depth = cv2.applyColorMap((255 * (1 - share)).astype(np.uint8), cv2.COLORMAP_TURBO)
    depth[~known] = 0
    both = np.hstack([cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR), depth])
    write_atomic(path, cv2.imencode(".png", both)[1].tobytes())
