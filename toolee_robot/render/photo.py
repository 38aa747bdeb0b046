"""What a colour camera does to an ideal image: exposure, white balance, blur, vignetting, grain, compression."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from toolee_robot.render.filters import gaussian, white


@dataclass(frozen=True)
class Photo:
    """gain: (3,) factor on the 8-bit sRGB channels. gamma: exponent. contrast: factor about mid-grey. blur: Gaussian
    sigma [px]. motion: length [px, at most 8] of a straight motion blur, motion_angle [rad]. vignette: darkening in the
    corners [share]. grain: standard deviation of noise [8-bit steps]. jpeg: quality 1-100, 0 for none."""

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
        """Some camera in some light."""
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


def photograph(rgb: NDArray[np.uint8], photo: Photo, rng: np.random.Generator) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB as that camera would deliver the ideal image `rgb`."""
    height, width = rgb.shape[:2]
    level = np.arange(256) / 255.0
    curve = 0.5 + photo.contrast * (level**photo.gamma - 0.5)
    table = np.clip(255.0 * curve[:, None] * np.asarray(photo.gain), 0, 255).astype(np.float32)
    image = np.stack([table[:, c].take(rgb[..., c]) for c in range(3)])
    if photo.blur > 0:
        image = gaussian(image, photo.blur)
    if photo.motion > 1:
        # The mean of copies shifted along the stroke; whole pixels are enough.
        half = photo.motion / 2 * np.array([np.sin(photo.motion_angle), np.cos(photo.motion_angle)])
        count = 2 * int(np.ceil(photo.motion))
        shifts = [np.round(t * half).astype(int) for t in np.linspace(-1, 1, count)]
        padded = np.pad(image, ((0, 0), (4, 4), (4, 4)), mode="edge")
        copies = [padded[:, 4 + a : 4 + a + height, 4 + b : 4 + b + width] for a, b in shifts]
        image = np.asarray(np.mean(copies, axis=0, dtype=np.float32))
    if photo.vignette > 0:
        y = (np.arange(height, dtype=np.float32) / height * 2 - 1)[:, None]
        x = np.arange(width, dtype=np.float32) / width * 2 - 1
        image = image * (1 - np.float32(photo.vignette) * (x * x + y * y) / 2)
    if photo.grain > 0:
        image = image + np.float32(photo.grain) * white(rng, image.shape)
    out = np.ascontiguousarray(np.clip(np.rint(image), 0, 255).astype(np.uint8).transpose(1, 2, 0))
    if photo.jpeg > 0:
        buffer = BytesIO()
        Image.fromarray(out).save(buffer, "JPEG", quality=photo.jpeg)
        out = np.array(Image.open(buffer))
    return out
