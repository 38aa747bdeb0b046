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
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from toolee_robot.render.material import Rendering
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.renderer import Image
from toolee_robot.types import CameraIntrinsics


@dataclass(frozen=True, eq=False)
class Surface:
    """The surfaces in a camera's pixels.

    Attributes:
        depth: True depth, (H, W) float32 [m]; 0 where there is nothing.
        cos_incidence: Cosine of the angle between ray and surface normal, (H, W) float32.
        shininess: Shininess in [0, 1], (H, W) float32.
        brightness: Linear brightness in [0, 1] as the colour camera sees it, (H, W) float32; the best guess here at
            what the surface returns of the sensor's own light.
    """

    depth: FloatArray
    cos_incidence: FloatArray
    shininess: FloatArray
    brightness: FloatArray

    @staticmethod
    def of(image: Image | Rendering) -> Surface:
        """The surfaces of a rendered image.

        Args:
            image: The image, on any device or in memory.

        Returns:
            The surfaces, in memory.
        """
        brightness = (_in_memory(image.rgb).mean(axis=2, dtype=np.float32) / np.float32(255.0)) ** np.float32(2.2)
        depth, cos_incidence, shininess = map(_in_memory, (image.depth, image.cos_incidence, image.shininess))
        return Surface(depth, cos_incidence, shininess, brightness)


def _in_memory(part: Any) -> Any:
    return part if isinstance(part, np.ndarray) else part.numpy()


def smooth_noise(shape: tuple[int, ...], size: float, rng: np.random.Generator) -> FloatArray:
    """A random field of zero mean and unit variance.

    Args:
        shape: Height and width [px].
        size: Distance over which neighbours are alike [px]; at 1 and below they are independent.
        rng: Random generator.

    Returns:
        The field, (H, W) float32.
    """
    height, width = shape
    if size <= 1.0:
        return rng.standard_normal((height, width), dtype=np.float32)
    rows, columns = (int(np.ceil(n / size)) + 3 for n in (height, width))
    coarse = rng.standard_normal((rows, columns), dtype=np.float32)
    fine = cv2.resize(coarse, (round(columns * size), round(rows * size)), interpolation=cv2.INTER_CUBIC)
    # The grid lies anywhere over the image, and its nodes vary more than what is between them.
    top, left = int(rng.integers(max(1, int(size)))), int(rng.integers(max(1, int(size))))
    field: FloatArray = fine[top : top + height, left : left + width] / np.float32(max(float(fine.std()), 1e-6))
    return field


def in_patches(chance: FloatArray, size: float, rng: np.random.Generator) -> np.ndarray:
    """Choose pixels in connected patches.

    Args:
        chance: Probability of each pixel to be chosen, (H, W).
        size: Size of the patches [px].
        rng: Random generator.

    Returns:
        Whether each pixel is chosen, (H, W) bool.
    """
    chosen: np.ndarray = ndtr(smooth_noise(chance.shape, size, rng)) < chance
    return chosen


_MARGIN = 0.015
"""Depth by which something must be in front to hide a pixel [m]."""


def hidden_from(depth: FloatArray, K: CameraIntrinsics, baseline: float) -> NDArray[np.bool_]:
    """Find the pixels that a second eye beside the camera does not see, because something nearer is in between.

    Args:
        depth: Depth, (H, W) [m]; 0 where there is nothing.
        K: Intrinsics of the camera.
        baseline: Place of the second eye along the image's x [m].

    Returns:
        Whether each pixel is hidden from it, (H, W) bool. A pixel outside its image is not.
    """
    height, width = depth.shape
    known = depth > 0
    rows, columns = np.nonzero(known)
    z = depth[known]
    there = np.rint(columns - K.fx * baseline / z).astype(np.int64)
    inside = (there >= 0) & (there < width)
    nearest = np.full(height * width, np.float32(np.inf))
    place = rows * width + np.clip(there, 0, width - 1)
    np.minimum.at(nearest, place[inside], z[inside])
    # Surfaces that the second eye sees wider leave gaps of a column: they are closed.
    columns_of_three = np.ones((1, 3), np.uint8)
    closed = cv2.dilate(cv2.erode(nearest.reshape(height, width), columns_of_three), columns_of_three)
    nearest = closed.reshape(-1)
    hidden = np.zeros(depth.shape, np.bool_)
    hidden[known] = inside & (z > nearest[place] + np.float32(_MARGIN))
    return hidden


@dataclass(frozen=True)
class Registration:
    """Registration of a depth camera beside the colour camera.

    Attributes:
        baseline: Place of the depth camera along the image's x [m].
        shift: What the registration is off by, along x and y [px].
    """

    baseline: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def random(baseline: float, rng: np.random.Generator, most: float = 1.5) -> Registration:
        """A camera on either side, registered to `most` pixels.

        Args:
            baseline: Distance of the two cameras [m].
            rng: Random generator.
            most: Largest error along an axis [px]; assumed.

        Returns:
            The registration.
        """
        x, y = rng.uniform(-most, most, 2)
        return Registration(float(rng.choice([-baseline, baseline])), (float(x), float(y)))

    def apply(self, reading: FloatArray, true_depth: FloatArray, K: CameraIntrinsics) -> FloatArray:
        """Register a reading.

        Args:
            reading: What the depth camera reads, in the colour camera's pixels, (H, W) [m].
            true_depth: Depth of the surfaces there, (H, W) [m].
            K: Intrinsics of the colour camera.

        Returns:
            The reading without what the depth camera cannot see, shifted, (H, W) float32 [m].
        """
        kept = np.where(hidden_from(true_depth, K, self.baseline), np.float32(0.0), reading)
        move = np.array([[1.0, 0.0, self.shift[0]], [0.0, 1.0, self.shift[1]]])
        return cv2.warpAffine(kept, move, (K.width, K.height), flags=cv2.INTER_NEAREST).astype(np.float32)


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
