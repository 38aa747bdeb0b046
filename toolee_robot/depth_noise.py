"""The noise of a time-of-flight depth camera of the Kinect v2 kind: what both of its implementations read.

`render.sensor` applies it to rendered images, a Warp kernel a pixel; `perception.pose.splat` to thousands of small
windows at a time in torch, where a pose network is trained without a renderer.

Axial noise: sigma_z = 1.5 - 0.5 z + 0.3 z^2 + 0.1 z^1.5 theta^2 / (pi/2 - theta)^2 [mm], z in metres, theta the angle
between ray and surface normal (Fankhauser et al., "Kinect v2 for mobile robot navigation", ICAR 2015). Lateral noise
about 1.6 mm. Pixels on depth edges mix the depths in front and behind or drop out; shiny and grazing surfaces drop out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

AXIAL_MM = (1.5, -0.5, 0.3, 0.1)
"""Coefficients of sigma_z: constant, of z, of z^2, of the slant's term."""
STEEPEST = 1.4835299
"""[rad] 85 deg: beyond, the formula was not fitted."""
GRAZING_WIDTH = 0.05235988
"""[rad] 3 deg: over which the share of pixels lost at a grazing incidence rises."""
NEAREST = 0.3
"""[m] Nearer than this the lateral jitter in pixels grows no more."""
NOTHING = 10.0
"""[m] A pixel without depth counts as so far away."""
OUT_OF_PHASE = 0.5
"""[m] Over larger steps the two returns fall out of phase: no reading."""
COMMON = 1.2
"""Standard deviation [px] of the blur by which neighbours have a part of their noise in common."""

RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "axial": (0.4, 1.8),
        "correlation": (0.0, 0.6),
        "lateral": (0.0006, 0.0025),
        "mixed": (0.2, 0.9),
        "edge_dropout": (0.0, 0.4),
        "shiny_dropout": (0.0, 0.6),
        "grazing_deg": (76.0, 87.0),
        "random_dropout": (0.0, 0.004),
    }
)
"""Of random sensors, uniform; `DepthNoise` says what each is."""
SYSTEMATIC = 0.001
"""Standard deviation of random sensors' bias [m] and of their scale."""


@dataclass(frozen=True)
class DepthNoise:
    """Parameters of one simulated sensor; the defaults are the nominal one's.

    Attributes:
        axial: Factor on sigma_z.
        correlation: Share of the axial variance that neighbours (about 3 px) have in common.
        lateral: Standard deviation of the lateral jitter [m].
        mixed: Probability that a pixel at a depth edge mixes both sides.
        edge_dropout: Probability that it is lost instead.
        edge_step: Depth step [m] that makes an edge.
        shiny_dropout: Probability of losing a pixel of a mirror-like surface seen away from its normal.
        grazing: Angle of incidence [rad] where half of the pixels are lost.
        random_dropout: Probability for any pixel.
        bias: Constant offset [m].
        scale: Relative depth error.
        minimum: Least range [m].
        maximum: Largest range [m].
        quantum: Step of the output [m].
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
        drawn = {name: float(rng.uniform(*bounds)) for name, bounds in RANGES.items()}
        drawn["grazing"] = float(np.deg2rad(drawn.pop("grazing_deg")))
        bias, scale = (float(rng.normal(0.0, SYSTEMATIC)) for _ in range(2))
        return DepthNoise(bias=bias, scale=scale, **drawn)
