"""Depth cameras that triangulate: structured light (PrimeSense, Kinect v1) and active stereo (RealSense D400).

Both find a disparity d = f b / z by matching a window of the pattern. Its noise and its step are constant in disparity,
so that they grow with z^2; neighbours under one window err together; at an outline the window belongs to both sides,
and the nearer one mostly wins; what the second eye (or the projector) does not see is lost.

Published: for PrimeSense f b = 580 px x 75 mm, steps of 1/8 px, sigma_z = 1.425e-3 z^2 (Khoshelham and Elberink,
Sensors 2012), a window of 9 x 9 px (Konolige and Mihelich, "Technical description of Kinect calibration", 2011);
for RealSense a baseline of 50 (D435) and 55 mm (D415), and a subpixel noise of 0.05 to 0.1 px ("Best known methods for
tuning Intel RealSense D400 depth cameras", 2018). Assumed: the shares that are lost, how outlines are shared, and how
much of the noise neighbours share.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.sensors.registration import hidden_from
from toolee_robot.render.sensors.surface import Surface, in_patches, smooth_noise
from toolee_robot.types import CameraIntrinsics

_EDGE = 0.02
"""Depth step that counts as an outline [m]."""
_MIRROR = 0.97
"""Cosine of incidence above which a polished surface throws the pattern straight back."""
_DARK = 0.04
"""Linear brightness under which a surface returns too little of the pattern."""


@dataclass(frozen=True)
class TriangulatingCamera:
    """A depth camera that triangulates.

    Attributes:
        baseline: Distance of the two eyes [m].
        focal: Focal length of the depth camera [px].
        noise: Standard deviation of the disparity [px].
        shared: Share of that variance which the pixels of a window have in common.
        step: Step of the disparity [px].
        window: Width of the matched window [px of the depth camera].
        fattening: Share of an outline's length along which the nearer side covers half a window of the farther one.
        polished: Share lost of polished surfaces that mirror the pattern, or are seen at a slant.
        dark: Share lost of black surfaces.
        slant: Cosine of incidence below which half is lost.
        nearest: Smallest range [m].
        farthest: Largest range [m].
        filled: Whether the driver fills holes from the left and smooths, as RealSense's hole-filling filter does.
    """

    baseline: float
    focal: float
    noise: float
    shared: float
    step: float
    window: float
    fattening: float
    polished: float
    dark: float
    slant: float
    nearest: float
    farthest: float = 6.0
    filled: bool = False

    @staticmethod
    def structured_light(rng: np.random.Generator) -> TriangulatingCamera:
        """Draw a structured-light camera: Kinect v1, PrimeSense, Xtion, Astra.

        Args:
            rng: Random generator.

        Returns:
            The camera.
        """
        u = rng.uniform
        return TriangulatingCamera(
            baseline=0.075,
            focal=580.0,
            noise=u(0.04, 0.1),
            shared=u(0.3, 0.8),
            step=0.125,
            window=9.0,
            fattening=u(0.3, 0.8),
            polished=u(0.2, 0.9),
            dark=u(0.2, 0.8),
            slant=u(0.1, 0.3),
            nearest=u(0.35, 0.5),
        )

    @staticmethod
    def active_stereo(rng: np.random.Generator, filled: bool = False) -> TriangulatingCamera:
        """Draw an active stereo camera: RealSense D415, D435, D455, Orbbec Gemini.

        Args:
            rng: Random generator.
            filled: Whether the driver fills the holes.

        Returns:
            The camera.
        """
        u = rng.uniform
        return TriangulatingCamera(
            baseline=u(0.05, 0.055),
            focal=u(420.0, 920.0),
            noise=u(0.05, 0.15),
            shared=u(0.6, 0.95),
            step=1 / 32,
            window=u(7.0, 13.0),
            fattening=u(0.5, 1.0),
            polished=u(0.0, 0.5),
            dark=u(0.0, 0.3),
            slant=u(0.05, 0.2),
            nearest=u(0.2, 0.4),
            filled=filled,
        )

    def measure(
        self,
        surface: Surface,
        K: CameraIntrinsics,
        rng: np.random.Generator,
        fields: np.random.Generator | None = None,
    ) -> FloatArray:
        """Measure depth.

        Args:
            surface: The surfaces.
            K: Intrinsics of the image.
            rng: Random generator of the noise that each pixel has for itself.
            fields: Random generator of what the pattern makes of the pixels: the error that a window shares, which side
                wins at an outline, what finds no match. A camera whose pattern stands still has the same in each
                frame. None for `rng`.

        Returns:
            Depth, (H, W) float32 [m]; 0 where there is none.
        """
        fields = rng if fields is None else fields
        window = self.window * K.fx / self.focal
        seen = self._outlines(surface.depth, window, fields)
        shape = seen.shape
        common, own = smooth_noise(shape, window, fields), rng.standard_normal(shape, dtype=np.float32)
        noise = np.float32(np.sqrt(self.shared)) * common + np.float32(np.sqrt(1.0 - self.shared)) * own
        product = np.float32(self.focal * self.baseline)
        with np.errstate(divide="ignore"):
            disparity = product / seen + np.float32(self.noise) * noise
        disparity = np.round(disparity / np.float32(self.step)) * np.float32(self.step)
        reading = product / np.maximum(disparity, np.float32(self.step))
        lost = (seen <= 0) | (reading < self.nearest) | (reading > self.farthest)
        lost |= hidden_from(surface.depth, K, self.baseline) | self._unmatched(surface, window, fields)
        kept: FloatArray = np.where(lost, 0.0, reading).astype(np.float32)
        return _filled(kept) if self.filled else kept

    def _outlines(self, depth: FloatArray, window: float, rng: np.random.Generator) -> FloatArray:
        """The depth that each window locks on to: one within it, at outlines mostly the nearer one."""
        height, width = depth.shape
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        reach = np.float32(0.25 * window)
        u, v = (smooth_noise(depth.shape, 0.5 * window, rng) * reach for _ in range(2))
        other = cv2.remap(depth, x + u, y + v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        seen = np.where((depth > 0) & (np.abs(other - depth) > _EDGE), other, depth)
        half = max(1, round(0.5 * window))
        nothing = np.float32(100.0)
        near = cv2.erode(np.where(depth > 0, depth, nothing), np.ones((2 * half + 1, 2 * half + 1), np.uint8))
        covered = (near < depth - _EDGE) & in_patches(np.full(depth.shape, self.fattening), 2.0 * window, rng)
        return np.where(covered, near, seen)

    def _unmatched(self, surface: Surface, window: float, rng: np.random.Generator) -> np.ndarray:
        """Where the pattern is not found again: on polished, black and slanted surfaces."""
        cos = surface.cos_incidence
        polished = self.polished * surface.shininess * np.where(cos > _MIRROR, 1.0, 1.0 - cos)
        dark = self.dark * np.clip(1.0 - surface.brightness / _DARK, 0.0, 1.0)
        slanted = 1.0 / (1.0 + np.exp(np.clip((cos - self.slant) / 0.04, -30.0, 30.0)))
        kept = (1.0 - polished) * (1.0 - dark) * (1.0 - slanted)
        return in_patches(1.0 - kept, window, rng)


def _filled(reading: FloatArray) -> FloatArray:
    """Fill holes with the last reading to their left, then take medians of 5 x 5 px."""
    last = np.where(reading > 0, np.arange(reading.shape[1]), 0)
    np.maximum.accumulate(last, axis=1, out=last)
    return cv2.medianBlur(np.take_along_axis(reading, last, axis=1), 5).astype(np.float32)
