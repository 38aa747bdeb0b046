"""Sensor model of a time-of-flight depth camera: `toolee_robot.depth_noise` on rendered images."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import warp as wp

from toolee_robot.depth_noise import COMMON, DepthNoise
from toolee_robot.render.device import DeviceArray, checked, empty, launch, put
from toolee_robot.render.kernels import sensor as kernels
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.sensors.filters import gaussian, normal_table, white
from toolee_robot.types import CameraIntrinsics


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
