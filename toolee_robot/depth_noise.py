"""The kinds of depth cameras, and the depth noise of a Kinect v2 (time of flight), shared by its two implementations.

One implementation is a Warp kernel that the renderer applies per pixel; the other, in torch, applies the noise to
thousands of small windows at once in the training of the pose network without a renderer.

Axial noise: sigma_z = 1.5 - 0.5 z + 0.3 z^2 + 0.1 z^1.5 theta^2 / (pi/2 - theta)^2 [mm], z in metres, theta the angle
between ray and surface normal (Fankhauser et al., "Kinect v2 for mobile robot navigation", ICAR 2015). Lateral noise
about 1.6 mm. Pixels on depth edges mix the depths in front and behind or drop out; shiny and grazing surfaces drop out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, get_args

import numpy as np

SensorKind = Literal[
    "time-of-flight", "time-of-flight-lab", "structured-light", "active-stereo", "filled-stereo", "mixed"
]
"""time-of-flight: noise and lost outlines alone. time-of-flight-lab: with systematic errors, holes and registration.
structured-light, active-stereo: see `render.triangulation`. filled-stereo: holes filled by the driver. mixed:
one of them, drawn for each image."""
KINDS: tuple[SensorKind, ...] = get_args(SensorKind)
"""All of them."""


AXIAL_MM = (1.5, -0.5, 0.3, 0.1)
"""Coefficients of sigma_z [mm]: the constant, z, z^2, and the term of the incidence angle."""
STEEPEST = 1.4835299
"""Incidence angle up to which the formula was fitted [rad] (85 deg)."""
GRAZING_WIDTH = 0.05235988
"""Range of incidence angles over which the share of lost pixels rises [rad] (3 deg)."""
NEAREST = 0.3
"""Depth below which the lateral jitter in pixels no longer grows [m]."""
NOTHING = 10.0
"""Depth assigned to a pixel without depth [m]."""
OUT_OF_PHASE = 0.5
"""Depth step above which the two returns are out of phase and give no reading [m]."""
COMMON = 1.2
"""Standard deviation of the blur that correlates the noise of neighbouring pixels [px]."""

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
"""Uniform ranges of a random sensor's parameters; see `DepthNoise` (`grazing_deg` is its `grazing` in degrees)."""
SYSTEMATIC = 0.001
"""Standard deviation of a random sensor's bias [m] and of its scale."""


@dataclass(frozen=True)
class DepthNoise:
    """Parameters of one simulated sensor; the defaults describe the nominal one.

    Attributes:
        axial: Factor on sigma_z.
        correlation: Share of the axial variance that is common to neighbouring pixels (about 3 px).
        lateral: Standard deviation of the lateral jitter [m].
        mixed: Probability that a pixel at a depth edge mixes both sides.
        edge_dropout: Probability that a pixel at a depth edge is lost instead.
        edge_step: Depth step that counts as an edge [m].
        shiny_dropout: Probability that a pixel of a specular surface seen off its normal is lost.
        grazing: Incidence angle at which half of the pixels are lost [rad].
        random_dropout: Probability that any pixel is lost.
        bias: Constant offset [m].
        scale: Relative depth error.
        minimum: Smallest range [m].
        maximum: Largest range [m].
        quantum: Resolution of the output [m].
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
        """Draw a sensor somewhat better or worse than the nominal one.

        Args:
            rng: Source of the random parameters.
        """
        drawn = {name: float(rng.uniform(*bounds)) for name, bounds in RANGES.items()}
        drawn["grazing"] = float(np.deg2rad(drawn.pop("grazing_deg")))
        bias, scale = (float(rng.normal(0.0, SYSTEMATIC)) for _ in range(2))
        return DepthNoise(bias=bias, scale=scale, **drawn)
