"""Sensor models on a rendered image: a colour camera, and depth cameras.

Colour has exposure, white balance, blur, vignetting, grain and compression. Depth follows `toolee_robot.depth_noise`,
which leaves out systematic errors of a time-of-flight camera. That they exist is published: wiggling with the distance
and an error that depends on the reflectivity (Lachat et al., "Assessment and calibration of a RGB-D camera (Kinect
v2)", Remote Sensing 2015; Lindner et al., "Time-of-flight sensor calibration for accurate range sensing", CVIU 2010),
light that took a longer way over polished surfaces (Fuchs, "Multipath interference compensation in time-of-flight
camera images", ICPR 2010). Their sizes here are assumed.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np
import PIL.Image
import warp as wp
from numpy.typing import NDArray
from scipy.special import ndtri

from toolee_robot.depth_noise import COMMON, KINDS, DepthNoise, SensorKind
from toolee_robot.render.device import DeviceArray, checked, empty, launch, put
from toolee_robot.render.kernels import sensor as kernels
from toolee_robot.render.material import Rendering
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.renderer import Image
from toolee_robot.render.triangulation import Registration, Surface, TriangulatingCamera, in_patches, smooth_noise
from toolee_robot.types import CameraIntrinsics


def gaussian(image: DeviceArray, sigma: float, device: str, gain: float = 1.0) -> DeviceArray:
    """Blur images by a Gaussian that is cut off at 3 sigma; borders are reflected.

    Args:
        image: The images, (C, H, W) float32.
        sigma: Standard deviation [px].
        device: Warp device.
        gain: Factor on the result.

    Returns:
        The blurred images, (C, H, W) float32.
    """
    radius = max(1, int(np.ceil(3.0 * sigma)))
    weights = np.exp(-0.5 * (np.arange(radius + 1) / sigma) ** 2)
    weights *= np.sqrt(gain) / (2 * weights.sum() - weights[0])  # once for each axis
    weights = put(weights.astype(np.float32), wp.float32, device)
    _, height, width = image.shape
    half, out = empty(image.size, wp.float32, device), empty(image.shape, wp.float32, device)
    launch(kernels.blur, image.size, image.reshape(-1), weights, 1, width, half, device=device)
    launch(kernels.blur, image.size, half, weights, width, height, out.reshape(-1), device=device)
    return out


def white(seed: int, shape: tuple[int, int, int], device: str) -> DeviceArray:
    """Independent standard normal numbers; equal seeds give equal ones on every device.

    Args:
        seed: The seed.
        shape: Their shape, (C, H, W).
        device: Warp device.

    Returns:
        The numbers, (C, H, W) float32.
    """
    out = empty(shape, wp.float32, device)
    launch(kernels.white, (out.size + 1) // 2, seed, normal_table(device), out.reshape(-1), device=device)
    return out


@lru_cache
def normal_table(device: str) -> DeviceArray:
    """Quantiles of the standard normal distribution that `kernels.sensor.normals` looks up, up to 4.3 sigma.

    Args:
        device: Warp device.

    Returns:
        The quantiles, (65536,) float32.
    """
    shares = (np.arange(kernels.NORMALS) + 0.5) / kernels.NORMALS
    return put(ndtri(shares).astype(np.float32), wp.float32, device)


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
        PIL.Image.fromarray(delivered).save(buffer, "JPEG", quality=photo.jpeg)
        delivered = np.array(PIL.Image.open(buffer))
    return delivered


def measure_depth(
    depth: FloatArray | DeviceArray,
    cos_incidence: FloatArray | DeviceArray,
    shininess: FloatArray | DeviceArray,
    intrinsics: CameraIntrinsics,
    noise: DepthNoise,
    rng: np.random.Generator,
    device: str = "cpu",
) -> FloatArray:
    """Apply the noise of a depth camera to a true depth.

    Arrays may be in memory or on the device.

    Args:
        depth: True depth, (H, W) [m]; 0 where there is nothing.
        cos_incidence: As `Rendering` gives it, (H, W).
        shininess: As `Rendering` gives it, (H, W).
        intrinsics: Intrinsics of the camera.
        noise: The noise model.
        rng: Random generator of the noise.
        device: "cpu" or "cuda".

    Returns:
        The measured depth, (H, W) float32 [m]; 0 where there is none.
    """
    checked(device)
    depth, cos_incidence, shininess = (put(a, wp.float32, device) for a in (depth, cos_incidence, shininess))
    beside, own, shared = (int(seed) for seed in rng.integers(2**31, size=3))
    flat, width = depth.reshape(-1), depth.shape[1]
    seen = flat
    if noise.lateral > 0:
        seen = empty(depth.size, wp.float32, device)
        spread = noise.lateral * intrinsics.fx
        jitter = (spread, noise.edge_step, beside, normal_table(device))
        launch(kernels.look_beside, depth.size, flat, width, *jitter, seen, device=device)
    common = empty(0, wp.float32, device)
    if noise.axial > 0 and noise.correlation > 0:
        # Scaled back to unit variance, which the blur takes from it.
        gain = 2.0 * np.sqrt(np.pi) * COMMON
        common = gaussian(white(shared, (1, *depth.shape), device), COMMON, device, gain).reshape(-1)
    out = empty(depth.shape, wp.float32, device)
    images = (flat, seen, cos_incidence.reshape(-1), shininess.reshape(-1), common)
    chances = (_sensor(noise), own, normal_table(device))
    launch(kernels.read, depth.size, *images, width, *chances, out.reshape(-1), device=device)
    reading: FloatArray = out.numpy()
    return reading


def _sensor(noise: DepthNoise) -> Any:
    sensor: Any = kernels.Sensor()
    for field in fields(noise):
        if field.name != "lateral":
            setattr(sensor, field.name, getattr(noise, field.name))
    return sensor


_PATCH = 0.012
"""Size of holes and of light's detours on a tool [m]."""
HELD_AT = 0.5
"""Distance of a tool that a station's camera looks at [m]."""


@dataclass(frozen=True)
class SystematicErrors:
    """What one camera does wrong in every frame.

    Attributes:
        wiggle: Amplitude of the error that swings with the distance [m].
        period: Its period [m].
        phase: Its phase [rad].
        black: Error of a black surface beside a white one [m].
        detour: Mean error of a polished surface, by light that came another way [m].
        holes: Share of polished surfaces that is lost, in patches: saturated where they mirror the light back, dark
            elsewhere.
        nearest: Smallest range [m].
    """

    wiggle: float
    period: float
    phase: float
    black: float
    detour: float
    holes: float
    nearest: float

    @staticmethod
    def random(rng: np.random.Generator) -> SystematicErrors:
        """Draw a camera.

        Args:
            rng: Random generator.

        Returns:
            Its errors.
        """
        u = rng.uniform
        return SystematicErrors(
            wiggle=u(0.0, 0.006),
            period=u(0.4, 1.2),
            phase=u(0.0, 2 * np.pi),
            black=u(-0.005, 0.01),
            detour=u(0.0, 0.015),
            holes=u(0.0, 0.7),
            nearest=u(0.3, 0.5),
        )

    def seen(
        self, surface: Surface, focal: float, rng: np.random.Generator, distance: float | None = None
    ) -> FloatArray:
        """The depth that the camera's noise acts on.

        Args:
            surface: The surfaces.
            focal: Focal length of the image [px].
            rng: Random generator of the patches, which belong to the pixels: frames of one camera take the same one,
                and the same distance.
            distance: Distance at which patches have their size [m]; None for the surfaces' median.

        Returns:
            Depth with the systematic errors, (H, W) float32 [m]; 0 where nothing is read.
        """
        depth, shine = surface.depth, surface.shininess
        known = depth > 0
        if distance is None:
            distance = max(float(np.median(depth[known])) if known.any() else 1.0, 0.1)
        size = _PATCH * focal / distance
        value = depth + np.float32(self.wiggle) * np.sin(2 * np.pi * depth / self.period + self.phase)
        value += np.float32(self.black) * (1.0 - surface.brightness) ** 4
        value += np.float32(self.detour) * shine * np.abs(smooth_noise(depth.shape, size, rng))
        lost = in_patches(self.holes * shine, size, rng) | ~known | (depth < self.nearest)
        return np.where(lost, 0.0, value).astype(np.float32)


_SINGLE = KINDS[:-1]
_SHARES = (0.3, 0.2, 0.2, 0.2, 0.1)
"""Shares of the single kinds in `mixed`."""
_BASELINES: dict[SensorKind, float] = {
    "time-of-flight-lab": 0.052,
    "structured-light": 0.025,
    "active-stereo": 0.015,
    "filled-stereo": 0.015,
}
"""Distance of the depth camera from the colour camera [m]: Kinect v2, Kinect v1, RealSense D435."""


def random_reading(
    kind: SensorKind,
    image: Image | Rendering,
    K: CameraIntrinsics,
    rng: np.random.Generator,
    device: str = "cpu",
    fields: np.random.Generator | None = None,
    noise: np.random.Generator | None = None,
) -> FloatArray:
    """Read depth with a randomly drawn sensor of a kind.

    Args:
        kind: The kind of sensor.
        image: The rendered image.
        K: Intrinsics of the camera.
        rng: Random generator of the sensor's parameters, and of all else that has none of its own. Readings of one
            sensor are given one of the same seed.
        device: "cpu" or "cuda".
        fields: Random generator of the sensor's smooth errors, which stay with the pixels: for readings of one sensor
            one of the same seed. None for `rng`.
        noise: Random generator of what differs between readings of one sensor; None for `rng`.

    Returns:
        Depth in the colour camera's pixels, (H, W) float32 [m]; 0 where there is none.
    """
    # The size of patches must not follow what is in the image where they stay.
    patches_at = None if fields is None else HELD_AT
    fields, noise = (rng if own is None else own for own in (fields, noise))
    if kind == "mixed":
        kind = _SINGLE[int(rng.choice(len(_SINGLE), p=_SHARES))]
    if kind == "time-of-flight":
        surface = (image.depth, image.cos_incidence, image.shininess)
        return measure_depth(*surface, K, DepthNoise.random(rng), noise, device)
    seen = Surface.of(image)
    if kind == "time-of-flight-lab":
        depth = SystematicErrors.random(rng).seen(seen, K.fx, fields, patches_at)
        surface = (depth, seen.cos_incidence, seen.shininess)
        reading = measure_depth(*surface, K, DepthNoise.random(rng), noise, device)
    elif kind == "structured-light":
        reading = TriangulatingCamera.structured_light(rng).measure(seen, K, noise, fields)
    else:
        camera = TriangulatingCamera.active_stereo(rng, filled=kind == "filled-stereo")
        reading = camera.measure(seen, K, noise, fields)
    return Registration.random(_BASELINES[kind], rng).apply(reading, seen.depth, K)
