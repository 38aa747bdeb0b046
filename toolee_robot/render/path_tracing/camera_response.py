"""A colour camera from the lens to the file: exposure, mosaic, sensor noise, white balance, tone curve, compression."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from toolee_robot.render.mesh import FloatArray

_KEY = 0.18
"""Brightness that the meter aims at."""
_LEVELS = 65535.0


@dataclass(frozen=True)
class CameraResponse:
    """A camera and its settings.

    Attributes:
        stops: What the exposure is off the meter's by, in powers of two.
        blur: Standard deviation of the lens's blur [px].
        motion: Length of a straight motion blur [px]; 0 for none.
        angle: Its direction in the image [rad].
        falloff: Loss of light in the corners, a share.
        electrons: Electrons of a white pixel; fewer are noisier.
        read_noise: Noise of reading [electrons].
        adaptation: Share of the mean colour's distance from grey that the white balance takes away.
        balance: Errors of the white balance, factors on red, green and blue.
        shoulder: Linear brightness that becomes white.
        contrast: Exponent of the curve about mid-grey.
        saturation: Factor on the distance from grey.
        sharpening: Strength of the sharpening.
        smoothing: Strength of the noise reduction [8-bit steps]; under 1 for none.
        quality: JPEG quality, 1 to 100.
    """

    stops: float
    blur: float
    motion: float
    angle: float
    falloff: float
    electrons: float
    read_noise: float
    adaptation: float
    balance: tuple[float, float, float]
    shoulder: float
    contrast: float
    saturation: float
    sharpening: float
    smoothing: float
    quality: int

    @staticmethod
    def random(rng: np.random.Generator) -> CameraResponse:
        """Draw a camera.

        Args:
            rng: Random generator.

        Returns:
            The camera.
        """
        red, green, blue = np.exp(rng.normal(0.0, 0.05, 3))
        return CameraResponse(
            stops=float(rng.normal(0.0, 0.5)),
            blur=float(rng.uniform(0.3, 0.9)),
            motion=float(rng.uniform(1.5, 4.0)) if rng.random() < 0.15 else 0.0,
            angle=float(rng.uniform(0.0, np.pi)),
            falloff=float(rng.uniform(0.0, 0.35)),
            electrons=float(np.exp(rng.uniform(np.log(800.0), np.log(15000.0)))),
            read_noise=float(rng.uniform(1.0, 4.0)),
            adaptation=float(rng.uniform(0.5, 1.0)),
            balance=(float(red), float(green), float(blue)),
            shoulder=float(rng.uniform(1.5, 6.0)),
            contrast=float(rng.uniform(0.9, 1.25)),
            saturation=float(rng.uniform(0.7, 1.2)),
            sharpening=float(rng.uniform(0.0, 0.8)),
            smoothing=float(rng.uniform(0.0, 3.5)),
            quality=int(rng.integers(70, 97)),
        )

    def picture(self, radiance: FloatArray, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Take a picture.

        Args:
            radiance: Linear RGB, (H, W, 3).
            rng: Random generator of the noise.

        Returns:
            The picture, sRGB, (H, W, 3) uint8.
        """
        metered = np.exp(np.mean(np.log(radiance.mean(axis=2) + 1e-4)))
        light = radiance * np.float32(_KEY / metered * 2.0**self.stops)
        light = self._through_lens(np.minimum(light, np.float32(4.0 * self.shoulder)))
        linear = self._sensed(light / self.shoulder, rng) * self.shoulder
        mean = linear.mean(axis=(0, 1)) + 1e-4
        linear *= np.asarray(self.balance, np.float32) * (mean.mean() / mean) ** np.float32(self.adaptation)
        curve = linear * (1.0 + linear / self.shoulder**2) / (1.0 + linear)
        value = np.clip(curve, 0.0, 1.0) ** (1.0 / 2.2)
        value = 0.5 * np.power(np.maximum(2.0 * value, 1e-6), self.contrast)
        grey = value.mean(axis=2, keepdims=True)
        value = (grey + self.saturation * (value - grey)).astype(np.float32)
        delivered = np.clip(255.0 * value + 0.5, 0, 255).astype(np.uint8)
        if self.smoothing >= 1.0:
            delivered = cv2.fastNlMeansDenoisingColored(delivered, None, self.smoothing, 2.0 * self.smoothing, 5, 11)
        soft = cv2.GaussianBlur(delivered, (0, 0), 1.0)
        delivered = cv2.addWeighted(delivered, 1.0 + self.sharpening, soft, -self.sharpening, 0.0).astype(np.uint8)
        buffer = BytesIO()
        Image.fromarray(delivered).save(buffer, "JPEG", quality=self.quality)
        return np.array(Image.open(buffer))

    def _through_lens(self, light: FloatArray) -> FloatArray:
        """Blur by lens and motion, loss of light in the corners."""
        light = cv2.GaussianBlur(light, (0, 0), self.blur).astype(np.float32)
        if self.motion > 0.0:
            size = 2 * int(np.ceil(self.motion / 2)) + 1
            along = np.linspace(-self.motion / 2, self.motion / 2, 16)
            rows = np.rint(size // 2 + along * np.sin(self.angle)).astype(int)
            columns = np.rint(size // 2 + along * np.cos(self.angle)).astype(int)
            kernel = np.zeros((size, size), np.float32)
            np.add.at(kernel, (rows, columns), np.float32(1 / 16))
            light = cv2.filter2D(light, -1, kernel, borderType=cv2.BORDER_REFLECT).astype(np.float32)
        height, width = light.shape[:2]
        y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
        return (light * (1.0 - self.falloff * (x**2 + y**2) / 2.0)[..., None]).astype(np.float32)

    def _sensed(self, light: FloatArray, rng: np.random.Generator) -> FloatArray:
        """What a sensor with a Bayer mosaic measures of light in [0, 1], its colours filled in."""
        mosaic = light[..., 1].copy()
        mosaic[0::2, 0::2] = light[0::2, 0::2, 0]
        mosaic[1::2, 1::2] = light[1::2, 1::2, 2]
        electrons = np.clip(mosaic, 0.0, 1.0) * self.electrons
        noise = rng.standard_normal(mosaic.shape) * np.sqrt(electrons + self.read_noise**2)
        # The black level lies above zero, so that the noise of dark pixels is not cut off.
        offset = 4.0 * self.read_noise
        level = (electrons + noise + offset) / (self.electrons + 8.0 * self.read_noise)
        raw = np.clip(_LEVELS * level, 0, _LEVELS).astype(np.uint16)
        filled: Any = cv2.cvtColor(raw, cv2.COLOR_BayerBG2RGB)  # OpenCV names the pattern by its second row
        value = filled.astype(np.float32) / _LEVELS * (self.electrons + 8.0 * self.read_noise) - offset
        return np.maximum(value / self.electrons, 0.0).astype(np.float32)
