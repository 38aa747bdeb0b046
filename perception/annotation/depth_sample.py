"""Depth at a clicked pixel: the median of its neighbours on the near surface, with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.depth_noise import AXIAL_MM, COMMON, STEEPEST, DepthNoise
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.types import RgbdFrame

REACH = 0.0055
"""Half of the window's width, a share of the focal length: 4 mm at 0.7 m, with two pixels at least."""
STEP = 0.012
"""Gap between the sorted depths of a window that parts two surfaces [m]."""
LEAST = 4
"""Fewest pixels of a surface in a window."""
_MEDIAN = np.pi / 2
"""Variance of a median over that of a mean, of normally distributed values."""


@dataclass(frozen=True, eq=False)
class DepthSample:
    """Depth about a pixel.

    Attributes:
        pixel: Mean of the pixels that it was taken from, (2,) as u, v; beside a hole it is not the click.
        z: Median depth of these pixels [m].
        pixels: Their flat indices in the image, (N,).
        correlation: Mean over all pairs of these pixels of the correlation of what neighbours' noise has in common.
    """

    pixel: Array
    z: float
    pixels: NDArray[np.int64]
    correlation: float


def sample_depth(
    frame: RgbdFrame, pixel: tuple[float, float], between: tuple[float, float] = (0.0, np.inf)
) -> DepthSample:
    """Depth at a click.

    Of a window about the click only the nearest surface counts: what lies behind, and is seen past the tool's edge or
    through a slot, is left out. Where the window shows none of it, one of twice the width is tried.

    Args:
        frame: The frame.
        pixel: The click, u and v [px].
        between: Depths that can be the tool's [m].

    Returns:
        The depth, and where it was taken.

    Raises:
        UserError: The click is outside of the image, or no surface there has depth.
    """
    height, width = frame.depth.shape
    u, v = round(pixel[0]), round(pixel[1])
    if not (0 <= u < width and 0 <= v < height):
        raise UserError(f"the click at {u}, {v} lies outside of the {width}x{height} image", code="user.click_outside")
    smallest = max(2, round(REACH * frame.intrinsics.fx))
    for r in (smallest, 2 * smallest):
        rows, columns = np.mgrid[max(v - r, 0) : min(v + r + 1, height), max(u - r, 0) : min(u + r + 1, width)]
        z = frame.depth[rows, columns].astype(np.float64)
        known = np.isfinite(z) & (z > between[0]) & (z < between[1])
        rows, columns, z = rows[known], columns[known], z[known]
        order = np.argsort(z)
        surfaces = np.split(order, np.flatnonzero(np.diff(z[order]) > STEP) + 1)
        near = next((s for s in surfaces if len(s) >= LEAST), None)
        if near is not None:
            at = np.stack([columns[near], rows[near]], 1).astype(np.float64)
            apart = ((at[:, None] - at[None]) ** 2).sum(2)
            correlation = float(np.exp(-apart / (4 * COMMON**2)).mean())  # of white noise, blurred by a Gaussian
            return DepthSample(at.mean(0), float(np.median(z[near])), rows[near] * width + columns[near], correlation)
    raise UserError(
        f"there is no depth of the tool about {u}, {v} (at least {LEAST} pixels of one surface are needed): click where "
        "the cloud shows it; if it has a hole there, photograph again from a little aside, and shield shiny steel from "
        "the lamp",
        code="user.no_depth_at_click",
    )


def depth_sigma(sample: DepthSample, incidence: float, share: float) -> float:
    """Standard deviation of the depth at a click.

    The sensor's model is that of `depth_noise`, part of whose noise neighbouring pixels have in common. Where the real
    sensor is noisier, the fit's residuals say so, and its covariance grows.

    Args:
        sample: The depth.
        incidence: Angle between the ray and the surface's normal [rad].
        share: Number of the sample's pixels, those that other samples have too divided between them.

    Returns:
        The standard deviation [m].
    """
    a, b, c, d = AXIAL_MM
    z, n, theta = sample.z, len(sample.pixels), min(incidence, STEEPEST)
    one = 1e-3 * (a + b * z + c * z**2 + d * z**1.5 * (theta / (np.pi / 2 - theta)) ** 2)
    common = DepthNoise.correlation
    of_median = (1 - common) * _MEDIAN / n + common * sample.correlation
    return float(one * np.sqrt(min(1.0, of_median * n / share)))
