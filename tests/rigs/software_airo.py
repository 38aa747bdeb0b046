"""A camera of airo-camera-toolkit's interface `RGBDCamera` without hardware: what the adapter is run against.

The toolkit has no software device. This has the methods of its interface that a camera must have, and fails as the
toolkit's own cameras do.
"""

from __future__ import annotations

import threading
import time
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from toolee_robot.types import CameraIntrinsics

COLOR = CameraIntrinsics(60.0, 61.0, 31.0, 22.0, 64, 48)
FPS = 60
TIMEOUT = 0.3
"""Time after which `grab_images` fails without an image [s]; the toolkit's cameras wait longer, up to 5."""


class SoftwareAiroCamera:
    """A camera that gives noise of 0 to 254 grey levels at 0.6 to 0.8 m, its uppermost row without depth."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self.frozen = self.silent = self.broken = False
        self.depth: float | None = None
        self._rgb: NDArray[np.uint8] = np.zeros((COLOR.height, COLOR.width, 3), np.uint8)
        self._depth: NDArray[np.float32] = np.zeros((COLOR.height, COLOR.width), np.float32)
        self._closed = threading.Event()

    def __enter__(self) -> Self:
        """Open it."""
        return self

    def __exit__(self, *_: object) -> None:
        self.broken = True
        self._closed.set()

    @property
    def resolution(self) -> tuple[int, int]:
        """Width and height [px]."""
        return COLOR.width, COLOR.height

    @property
    def fps(self) -> int:
        """Frames per second."""
        return FPS

    def intrinsics_matrix(self) -> NDArray[np.float64]:
        """The camera matrix, (3, 3)."""
        return COLOR.matrix

    def grab_images(self) -> None:
        """Wait for the next pair of images."""
        time.sleep(1 / FPS)
        if self.silent:
            self._closed.wait(TIMEOUT)
        if self.broken or self.silent:
            raise RuntimeError(f"Frame didn't arrive within {TIMEOUT * 1e3:.0f}")
        if not self.frozen:
            self._rgb = self._rng.integers(0, 255, self._rgb.shape).astype(np.uint8)
            noise = (0.6 + 0.2 * self._rng.random(self._depth.shape)).astype(np.float32)
            self._depth = noise if self.depth is None else np.full_like(noise, self.depth)
            self._depth[0] = np.nan

    def retrieve_rgb_image_as_int(self) -> NDArray[np.uint8]:
        """The colour image, (H, W, 3)."""
        return self._rgb

    def retrieve_rgb_image(self) -> NDArray[np.float64]:
        """The colour image, (H, W, 3), 0 to 1."""
        return self._rgb / 255

    def retrieve_depth_map(self) -> NDArray[np.float32]:
        """The depth image, (H, W) [m]; NaN where unknown."""
        return self._depth

    def retrieve_depth_image(self) -> NDArray[np.uint8]:
        """The depth as a picture for people, (H, W, 3)."""
        return self._rgb

    def retrieve_colored_point_cloud(self) -> Any:
        """The toolkit's point cloud, which the adapter does not ask for."""
        raise NotImplementedError
