"""Sensor models on a rendered image: a colour camera, a time-of-flight depth camera, and the filters that both use.

Colour has exposure, white balance, blur, vignetting, grain and compression; depth follows `toolee_robot.depth_noise`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from PIL import Image
from scipy.special import ndtri

from toolee_robot.depth_noise import COMMON, DepthNoise
from toolee_robot.render.device import DeviceArray, checked, empty, launch, put
from toolee_robot.render.kernels import sensor as kernels
from toolee_robot.render.mesh import FloatArray
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
        Image.fromarray(delivered).save(buffer, "JPEG", quality=photo.jpeg)
        delivered = np.array(Image.open(buffer))
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
