"""The clicks on one end effector as a camera's measurements: pixels, depths, and their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.depth_noise import SYSTEMATIC
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.perception.offline.annotation.clicks import ClickedEnd
from toolee_robot.perception.offline.annotation.depth_sample import DepthSample, sample_depth
from toolee_robot.perception.offline.annotation.protocol import PROTOCOL, Role
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
        raise UserError(f"a {protocol.label} has no clicks of the kind {foreign[0]}: undo them", code="user.click_role")
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
        raise UserError(f"caliper: {end.caliper_mm:g} mm is no {protocol.caliper}", code="user.caliper")
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
