"""Sensor model of a colour camera: exposure, white balance, blur, vignetting, grain, compression."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np
import warp as wp
from numpy.typing import NDArray
from PIL import Image

from toolee_robot.render.device import DeviceArray, checked, empty, launch, put
from toolee_robot.render.kernels import photo as kernels
from toolee_robot.render.sensors.filters import gaussian, normal_table


@dataclass(frozen=True)
class Photo:
    """Properties of a colour camera and its light.

    Attributes:
        gain: Factor on each 8-bit sRGB channel, (3,).
        gamma: Exponent.
        contrast: Factor about mid-grey.
        blur: Standard deviation of a Gaussian blur [px].
        motion: Length of a straight motion blur [px], at most 8.
        motion_angle: Direction of the motion blur in the image [rad].
        vignette: Darkening in the corners, a share.
        grain: Standard deviation of the noise [8-bit steps].
        jpeg: JPEG quality, 1 to 100; 0 for no compression.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gamma: float = 1.0
    contrast: float = 1.0
    blur: float = 0.5
    motion: float = 0.0
    motion_angle: float = 0.0
    vignette: float = 0.08
    grain: float = 1.5
    jpeg: int = 0

    @staticmethod
    def random(rng: np.random.Generator) -> Photo:
        """Draw a camera in some light."""
        gain = rng.uniform(0.7, 1.15) * np.exp(rng.normal(0.0, 0.06, 3))
        return Photo(
            gain=(float(gain[0]), float(gain[1]), float(gain[2])),
            gamma=float(np.exp(rng.normal(0.0, 0.15))),
            contrast=float(np.exp(rng.normal(0.0, 0.12))),
            blur=float(rng.uniform(0.2, 1.1)),
            motion=float(rng.uniform(1.5, 5.0)) if rng.random() < 0.15 else 0.0,
            motion_angle=float(rng.uniform(0.0, np.pi)),
            vignette=float(rng.uniform(0.0, 0.25)),
            grain=float(rng.uniform(0.3, 6.0)),
            jpeg=int(rng.integers(55, 96)) if rng.random() < 0.5 else 0,
        )


def photograph(
    rgb: NDArray[np.uint8] | DeviceArray, photo: Photo, rng: np.random.Generator, device: str = "cpu"
) -> NDArray[np.uint8]:
    """Apply the effects of a camera to an ideal image.

    Args:
        rgb: The ideal image, sRGB, (H, W, 3), in memory or on the device.
        photo: The camera.
        rng: Random generator of the noise.
        device: "cpu" or "cuda".

    Returns:
        The camera's image, sRGB, (H, W, 3) uint8.
    """
    checked(device)
    rgb = put(rgb, wp.uint8, device)
    height, width = rgb.shape[:2]
    shape = (3, height, width)
    level = np.arange(256) / 255.0
    curve = 0.5 + photo.contrast * (level**photo.gamma - 0.5)
    table = np.clip(255.0 * curve[:, None] * np.asarray(photo.gain), 0, 255).astype(np.float32)
    image = empty(shape, wp.float32, device)
    table = put(table.reshape(-1), wp.float32, device)
    launch(kernels.through_curve, height * width, rgb.reshape(-1), table, image.reshape(-1), device=device)
    if photo.blur > 0:
        image = gaussian(image, photo.blur, device)
    if photo.motion > 1:
        half = photo.motion / 2 * np.array([np.sin(photo.motion_angle), np.cos(photo.motion_angle)])
        strokes = np.linspace(-1, 1, 2 * int(np.ceil(photo.motion)))
        shifts = put(np.round(strokes[:, None] * half).astype(np.int32), wp.int32, device)
        moved, image = image, empty(shape, wp.float32, device)
        launch(kernels.smear, image.size, moved.reshape(-1), width, height, shifts, image.reshape(-1), device=device)
    out = empty((height, width, 3), wp.uint8, device)
    effects = (photo.vignette, photo.grain, int(rng.integers(2**31)), normal_table(device))
    launch(kernels.expose, height * width, image.reshape(-1), width, *effects, out.reshape(-1), device=device)
    delivered: NDArray[np.uint8] = out.numpy()
    if photo.jpeg > 0:
        buffer = BytesIO()
        Image.fromarray(delivered).save(buffer, "JPEG", quality=photo.jpeg)
        delivered = np.array(Image.open(buffer))
    return delivered
