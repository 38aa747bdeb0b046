"""The lens of an emulated camera: a rendered image as the lens would distort it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.cameras import Lens, StatedLens
from toolee_robot.render.scene import Rendering
from toolee_robot.station import CameraConfig

MARGIN = 2
"""Pixels that are rendered beyond what the lens sees."""


class EmulatedLens:
    """A lens with distortion, in front of the renderer, whose camera is a pinhole.

    Args:
        camera: The camera; it states a distortion.
        finer: Rendered pixels for each pixel along each edge, for smooth edges.

    Attributes:
        lens: The lens.
        rendered: The camera to render with: the same, with as much more to each side as the lens sees there.
    """

    def __init__(self, camera: CameraConfig, finer: int = 1) -> None:
        lens = self.lens = lens_of(camera)
        k = lens.intrinsics
        x, y = lens.rays()
        u, v = x * k.fx + k.cx, y * k.fy + k.cy
        left, top = (max(0, int(np.ceil(-low.min()))) + MARGIN for low in (u, v))
        right, bottom = (
            max(0, int(np.ceil(high.max())) - size + 1) + MARGIN for high, size in ((u, k.width), (v, k.height))
        )
        self._size, self._finer = (left + k.width + right, top + k.height + bottom), finer
        # Pixel centres are at integer coordinates, so that an image begins at -0.5.
        self.rendered = replace(
            camera,
            fx=finer * k.fx,
            fy=finer * k.fy,
            cx=finer * (k.cx + left + 0.5) - 0.5,
            cy=finer * (k.cy + top + 0.5) - 0.5,
            width=finer * self._size[0],
            height=finer * self._size[1],
        )
        self._u, self._v = (u + left).astype(np.float32), (v + top).astype(np.float32)

    def __call__(self, rendering: Rendering) -> Rendering:
        """Distort a rendering.

        Args:
            rendering: What `rendered` sees.

        Returns:
            What the lens shows: colour is interpolated, of all else each pixel has that of the nearest one.
        """
        smooth = np.asarray(cv2.resize(rendering.rgb, self._size, interpolation=cv2.INTER_AREA))
        middle = slice(self._finer // 2, None, self._finer)
        return Rendering(
            self._remapped(smooth, cv2.INTER_LINEAR),
            *(
                self._remapped(np.ascontiguousarray(image[middle, middle]), cv2.INTER_NEAREST)
                for image in (rendering.depth, rendering.body_ids, rendering.cos_incidence, rendering.shininess)
            ),
        )

    def _remapped(self, image: NDArray[Any], how: int) -> NDArray[Any]:
        return np.asarray(cv2.remap(image, self._u, self._v, how), image.dtype)


def lens_of(camera: CameraConfig) -> Lens:
    """The lens that a station file states.

    Args:
        camera: The camera.

    Returns:
        The lens; one without distortion where the file states none.
    """
    if camera.distortion is None:
        return Lens(camera.intrinsics)
    return StatedLens(camera.intrinsics, camera.distortion).lens
