"""What a time-of-flight depth camera of the Kinect v2 kind makes of a true depth image.

Axial noise: sigma_z = 1.5 - 0.5 z + 0.3 z^2 + 0.1 z^1.5 theta^2 / (pi/2 - theta)^2 [mm], z in metres, theta the angle
between ray and surface normal (Fankhauser et al., "Kinect v2 for mobile robot navigation", ICAR 2015). Lateral noise
about 1.6 mm. Pixels on depth edges mix the depths in front and behind or drop out; shiny and grazing surfaces drop out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.render.filters import gaussian, local_range, white
from toolee_robot.render.mesh import FloatArray
from toolee_robot.types import CameraIntrinsics


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


NOISELESS = DepthNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.02, 0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0, 1e3, 0.0)


def axial_sigma(depth: FloatArray | Array, incidence: FloatArray | Array) -> FloatArray:
    """Standard deviation [m] of a depth [m] on a surface whose normal makes `incidence` [rad] with the ray."""
    z = np.asarray(depth, np.float32)
    theta = np.minimum(np.asarray(incidence, np.float32), np.float32(np.deg2rad(85.0)))
    skew = 0.1 * z * np.sqrt(z) * (theta / (np.float32(np.pi / 2) - theta)) ** 2
    sigma: FloatArray = (1.5 - 0.5 * z + 0.3 * z * z + skew).astype(np.float32) * np.float32(1e-3)
    return sigma


def measure_depth(
    depth: FloatArray,
    cos_incidence: FloatArray,
    shininess: FloatArray,
    intrinsics: CameraIntrinsics,
    noise: DepthNoise,
    rng: np.random.Generator,
) -> FloatArray:
    """The sensor's reading (H, W) float32 [m], 0 where it has none, of a true depth (H, W) [m] (0: nothing there).

    cos_incidence, shininess: (H, W), as `Rendering` gives them.
    """
    seen = _displaced(depth, intrinsics, noise, rng)
    cos = np.clip(cos_incidence, 0.0, 1.0)
    incidence = np.arccos(cos)
    # The jitter may pull in a neighbour whose incidence is another: at edges the difference does not matter.
    out = seen * np.float32(1 + noise.scale) + np.float32(noise.bias)
    if noise.axial > 0:
        own, common = white(rng, (2, *depth.shape))
        common = gaussian(common, 1.2) * np.float32(2.0 * np.sqrt(np.pi) * 1.2)  # back to unit variance
        share = np.float32(noise.correlation)
        unit = np.sqrt(1 - share) * own + np.sqrt(share) * common
        out += np.float32(noise.axial) * axial_sigma(seen, incidence) * unit
    _spoil_edges(out, seen, noise, rng)
    # What a surface gives back despite its shine, and at its slant, and by luck.
    kept = np.full(depth.shape, 1 - noise.random_dropout, np.float32)
    if noise.shiny_dropout > 0:
        kept *= 1 - np.float32(noise.shiny_dropout) * shininess * np.sqrt(1 - cos * cos)
    if noise.grazing < np.pi / 2:
        width = np.float32(np.deg2rad(3.0))
        kept /= 1 + np.exp(np.clip((incidence - np.float32(noise.grazing)) / width, -30, 30))
    lost = rng.random(depth.shape, dtype=np.float32) >= kept
    lost |= (out < noise.minimum) | (out > noise.maximum) | (depth <= 0) | (seen <= 0)
    out[lost] = 0
    if noise.quantum > 0:
        out = np.rint(out * np.float32(1 / noise.quantum)) * np.float32(noise.quantum)
    return out


def _spoil_edges(out: FloatArray, seen: FloatArray, noise: DepthNoise, rng: np.random.Generator) -> None:
    """Mix or lose (0) the readings `out` (in place) on edges of the depth `seen`."""
    low, high = _neighbourhood(seen)
    index = np.flatnonzero((high - low > noise.edge_step) & (seen > 0))
    low, high = low.reshape(-1).take(index), high.reshape(-1).take(index)
    chance, weight, loss = rng.random((3, len(index)), dtype=np.float32)
    # Mixtures gather near the two surfaces: pull the weight towards the nearer end.
    weight = np.where(weight < 0.5, 2 * weight * weight, 1 - 2 * (1 - weight) ** 2)
    mixing = (chance < noise.mixed) & (weight > 0.5)
    # Over steps of more than half a metre the two returns fall out of phase: no reading.
    mixture = np.where(high - low > 0.5, np.float32(0), low + weight * (high - low))
    flat = out.reshape(-1)
    flat[index[mixing]] = mixture[mixing]
    flat[index[loss < noise.edge_dropout]] = 0


def _displaced(
    depth: FloatArray, intrinsics: CameraIntrinsics, noise: DepthNoise, rng: np.random.Generator
) -> FloatArray:
    """The depth with each pixel looking up to a few pixels beside its place: lateral noise. A pixel that would jump
    over a small step keeps its value, so that only outlines fray, not slopes (their error is in sigma_z)."""
    if noise.lateral <= 0:
        return depth
    height, width = depth.shape
    sigma = np.float32(noise.lateral * intrinsics.fx) / np.maximum(depth, np.float32(0.3))
    down, right = white(rng, (2, height, width)) * sigma
    rows = np.clip(np.rint(np.arange(height, dtype=np.float32)[:, None] + down), 0, height - 1).astype(np.int32)
    columns = np.clip(np.rint(np.arange(width, dtype=np.float32) + right), 0, width - 1).astype(np.int32)
    other = depth.reshape(-1).take(rows * width + columns)
    jump = np.abs(other - depth) > noise.edge_step
    return np.where(jump & (depth > 0), other, depth)


def _neighbourhood(depth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest depth in the 3x3 neighbourhood; pixels without depth count as 10 m."""
    filled: FloatArray = np.where(depth > 0, depth, np.float32(10.0))
    return local_range(filled)
