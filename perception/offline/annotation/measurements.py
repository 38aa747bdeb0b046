"""The clicks on one end effector as a camera's measurements: pixels, depths, and their standard deviations.

The depth at a click is the median of its neighbours on the near surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.depth_noise import AXIAL_MM, COMMON, STEEPEST, SYSTEMATIC, DepthNoise
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.perception.offline.annotation.clicks import PROTOCOL, ClickedEnd, Role
from toolee_robot.types import CameraIntrinsics, RgbdFrame

CLICK = 1.0
"""Standard deviation of a click, along u and along v [px]."""
CALIPER = 0.1e-3
"""Standard deviation of a caliper's reading [m]."""
EDGES = (Role.THROAT, Role.END_A, Role.END_B)
"""Roles whose clicks lie on edges."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """A measured click.

    Attributes:
        number: Index of the click among those of its end.
        role: What it shows.
        pixel: The click, (2,) as u, v [px].
        depth: The depth about it; None where the role has none.
        share: Number of the depth's pixels, those in several windows divided between them.
    """

    number: int
    role: Role
    pixel: Array
    depth: DepthSample | None
    share: float


@dataclass(frozen=True, eq=False)
class Measurements:
    """The measured clicks on one end effector.

    Attributes:
        camera: The camera.
        clicks: Every click but the box's corners.
        caliper: What the caliper measured [m]; None: not measured.
        bias: Standard deviation of the error that all depths have in common [m].
    """

    camera: CameraIntrinsics
    clicks: tuple[Measurement, ...]
    caliper: float | None
    bias: float

    def of(self, role: Role) -> list[Measurement]:
        """The clicks of a role."""
        return [m for m in self.clicks if m.role is role]

    def rays(self, pixels: Array) -> Array:
        """Points (..., 3) at depth 1 on the rays through pixels (..., 2)."""
        return self.camera.rays(pixels)

    def point(self, click: Measurement) -> Array:
        """Where a click's depth was measured, (3,) [m]."""
        assert click.depth is not None
        return self.rays(click.depth.pixel) * click.depth.z


def measure(frame: RgbdFrame, end: ClickedEnd) -> Measurements:
    """Measure clicks.

    Args:
        frame: The frame.
        end: The clicks on one end effector.

    Returns:
        The measurements.

    Raises:
        UserError: Clicks or the caliper's reading are missing, or a click has no depth; the message says which.
    """
    protocol = PROTOCOL[end.shape]
    foreign = [c.role for c in end.clicks if c.role not in protocol.clicks and c.role is not Role.BOX]
    if foreign:
        raise UserError(f"a {protocol.label} has no clicks of the kind {foreign[0]}: undo them")
    for role, asked in protocol.clicks.items():
        if len(end.of(role)) < asked.least:
            raise UserError(
                f"{protocol.label}: {len(end.of(role))} of {asked.least} clicks of the kind {role}: {asked.where}",
                code="user.clicks_missing",
            )
    if end.caliper_mm is None and protocol.caliper_needed:
        raise UserError(
            f"{protocol.label}: measure with a caliper and enter the {protocol.caliper}", code="user.caliper_missing"
        )
    if end.caliper_mm is not None and not 0.5 <= end.caliper_mm <= 150.0:
        raise UserError(f"caliper: {end.caliper_mm:g} mm is not a plausible {protocol.caliper}")
    # What a click at an edge shows beside the tool is told by the depth of the surface.
    surface = [sample_depth(frame, (c.u, c.v)).z for c in end.of(Role.SURFACE)]
    reach = protocol.category.spec.radius
    edge = (float(np.median(surface)) - reach, float(np.median(surface)) + reach) if surface else (0.0, np.inf)
    sampled = []
    for number, click in enumerate(end.clicks):
        if click.role is not Role.BOX:
            between = edge if click.role in EDGES else (0.0, np.inf)
            deep = protocol.clicks[click.role].depth
            sampled.append((number, click, sample_depth(frame, (click.u, click.v), between) if deep else None))
    pixels = [depth.pixels for _, _, depth in sampled if depth is not None]
    used, counts = np.unique(np.concatenate(pixels), return_counts=True) if pixels else (np.empty(0), np.empty(0))
    clicks = []
    for number, click, depth in sampled:
        share = 0.0 if depth is None else float((1.0 / counts[np.searchsorted(used, depth.pixels)]).sum())
        clicks.append(Measurement(number, click.role, np.array([click.u, click.v]), depth, share))
    middle = float(np.median([m.depth.z for m in clicks if m.depth is not None]))
    caliper = None if end.caliper_mm is None else end.caliper_mm / 1000.0
    return Measurements(frame.intrinsics, tuple(clicks), caliper, float(np.hypot(SYSTEMATIC, SYSTEMATIC * middle)))


REACH = 0.0055
"""Half of the window's width, a share of the focal length: 4 mm at 0.7 m, with two pixels at least."""
STEP = 0.012
"""Depths of a window that lie no farther behind the nearest one are of one surface [m]."""
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
        scatter: Standard deviation of these depths about the plane that suits them best [m].
        correlation: Mean over all pairs of these pixels of the correlation of what neighbours' noise has in common.
    """

    pixel: Array
    z: float
    pixels: NDArray[np.int64]
    scatter: float
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
        near = _nearest(z)
        if len(near):
            at = np.stack([columns[near], rows[near]], 1).astype(np.float64)
            apart = ((at[:, None] - at[None]) ** 2).sum(2)
            correlation = float(np.exp(-apart / (4 * COMMON**2)).mean())  # of white noise, blurred by a Gaussian
            pixels = rows[near] * width + columns[near]
            return DepthSample(at.mean(0), float(np.median(z[near])), pixels, _scatter(at, z[near]), correlation)
    raise UserError(
        f"there is no depth of the tool near {u}, {v} (at least {LEAST} pixels of one surface are needed). Click "
        "where the cloud shows it. If the cloud has a hole there, photograph again from a little aside, and shield "
        "shiny steel from the lamp",
        code="user.no_depth_at_click",
    )


def _nearest(z: Array) -> NDArray[np.int64]:
    """Indices of the depths of the nearest surface; none where no surface has LEAST pixels.

    It ends STEP behind its beginning, because at an edge pixels mix its depth with that of what lies behind, in all
    proportions. Of a surface that is deeper than that its near part is left, with the pixels that it was seen at.
    """
    order = np.argsort(z)
    for first in range(len(order) - LEAST + 1):
        if z[order[first + LEAST - 1]] - z[order[first]] <= STEP:
            return order[first:][z[order[first:]] <= z[order[first]] + STEP]
    return np.empty(0, np.int64)


def _scatter(at: Array, z: Array) -> float:
    A = np.column_stack([at - at.mean(0), np.ones(len(at))])
    left = z - A @ np.linalg.lstsq(A, z, rcond=None)[0]
    return float(np.sqrt(left @ left / max(len(z) - 3, 1)))


def pixel_sigma(z: float, incidence: float) -> float:
    """Standard deviation of one pixel's depth by the model of `depth_noise`.

    Args:
        z: Depth [m].
        incidence: Angle between the ray and the surface's normal [rad].

    Returns:
        The standard deviation [m].
    """
    a, b, c, d = AXIAL_MM
    theta = min(incidence, STEEPEST)
    return float(1e-3 * (a + b * z + c * z**2 + d * z**1.5 * (theta / (np.pi / 2 - theta)) ** 2))


def noise_factor(samples: Sequence[DepthSample], incidence: float) -> float:
    """How much noisier than the model's a sensor is.

    Args:
        samples: Depths on one surface.
        incidence: Angle between the rays and the surface's normal [rad].

    Returns:
        Ratio of the pixels' scatter to what the model says; at least 1.
    """
    enough = [s for s in samples if len(s.pixels) >= 9]
    if not enough:
        return 1.0
    ratios = [(s.scatter / pixel_sigma(s.z, incidence)) ** 2 for s in enough]
    return float(np.sqrt(max(1.0, np.median(ratios))))


def depth_sigma(sample: DepthSample, incidence: float, share: float, noise: float = 1.0) -> float:
    """Standard deviation of the depth at a click; part of the pixels' noise is common to neighbours.

    Args:
        sample: The depth.
        incidence: Angle between the ray and the surface's normal [rad].
        share: Number of the sample's pixels, those that other samples have too divided between them.
        noise: How much noisier than the model's the sensor is, see `noise_factor`.

    Returns:
        The standard deviation [m].
    """
    n, common = len(sample.pixels), DepthNoise.correlation
    of_median = (1 - common) * _MEDIAN / n + common * sample.correlation
    return noise * pixel_sigma(sample.z, incidence) * float(np.sqrt(min(1.0, of_median * n / share)))
