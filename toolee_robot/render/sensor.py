"""What a time-of-flight depth camera of the Kinect v2 kind makes of a true depth image.

Axial noise: sigma_z = 1.5 - 0.5 z + 0.3 z^2 + 0.1 z^1.5 theta^2 / (pi/2 - theta)^2 [mm], z in metres, theta the angle
between ray and surface normal (Fankhauser et al., "Kinect v2 for mobile robot navigation", ICAR 2015). Lateral noise
about 1.6 mm. Pixels on depth edges mix the depths in front and behind or drop out; shiny and grazing surfaces drop out.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import warp as wp

from toolee_robot.render.device import DeviceArray, checked, empty, launch, put
from toolee_robot.render.filters import gaussian, normal_table, white
from toolee_robot.render.kernels import sensor as kernels
from toolee_robot.render.mesh import FloatArray
from toolee_robot.types import CameraIntrinsics

_COMMON = 1.2
"""Standard deviation [px] of the blur by which neighbours have a part of their noise in common."""


@dataclass(frozen=True)
class DepthNoise:
    """Parameters of one simulated sensor.

    axial: factor on sigma_z. correlation: share of the axial variance that neighbours (about 3 px) have in common.
    lateral: standard deviation of the lateral jitter [m]. mixed: probability that a pixel at a depth edge mixes both
    sides, edge_dropout: that it is lost instead. edge_step: depth step [m] that makes an edge. shiny_dropout:
    probability of losing a pixel of a mirror-like surface seen away from its normal. grazing: angle of incidence
    [rad] where half of the pixels are lost. random_dropout: probability for any pixel. bias: constant offset [m];
    scale: relative depth error. minimum, maximum: range [m]. quantum: step of the output [m].
    """

    axial: float = 1.0
    correlation: float = 0.3
    lateral: float = 0.0016
    mixed: float = 0.6
    edge_dropout: float = 0.15
    edge_step: float = 0.02
    shiny_dropout: float = 0.25
    grazing: float = float(np.deg2rad(83.0))
    random_dropout: float = 0.001
    bias: float = 0.0
    scale: float = 0.0
    minimum: float = 0.25
    maximum: float = 8.0
    quantum: float = 0.001

    @staticmethod
    def random(rng: np.random.Generator) -> DepthNoise:
        """A sensor somewhat better or worse than the nominal one."""
        return replace(
            DepthNoise(),
            axial=float(rng.uniform(0.4, 1.8)),
            correlation=float(rng.uniform(0.0, 0.6)),
            lateral=float(rng.uniform(0.0006, 0.0025)),
            mixed=float(rng.uniform(0.2, 0.9)),
            edge_dropout=float(rng.uniform(0.0, 0.4)),
            shiny_dropout=float(rng.uniform(0.0, 0.6)),
            grazing=float(np.deg2rad(rng.uniform(76.0, 87.0))),
            random_dropout=float(rng.uniform(0.0, 0.004)),
            bias=float(rng.normal(0.0, 0.001)),
            scale=float(rng.normal(0.0, 0.001)),
        )


def measure_depth(
    depth: FloatArray | DeviceArray,
    cos_incidence: FloatArray | DeviceArray,
    shininess: FloatArray | DeviceArray,
    intrinsics: CameraIntrinsics,
    noise: DepthNoise,
    rng: np.random.Generator,
    device: str = "cpu",
) -> FloatArray:
    """The sensor's reading (H, W) float32 [m], 0 where it has none, of a true depth (H, W) [m] (0: nothing there).

    cos_incidence, shininess: (H, W), as `Rendering` gives them. Arrays in memory, or on `device`.
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
        gain = 2.0 * np.sqrt(np.pi) * _COMMON
        common = gaussian(white(shared, (1, *depth.shape), device), _COMMON, device, gain).reshape(-1)
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
