"""From a mask and a depth image to the cleaned partial cloud of an end effector, in the camera frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.perception.pose.canonical import MIN_POINTS, REST_REACH, complete_depth, surface_step
from toolee_robot.types import CameraIntrinsics, Detection, RgbdFrame

NEAREST, FARTHEST = 0.05, 20.0
"""Range of plausible depths [m] of a tool in a hand in front of a depth camera."""
TRIM_RADII = 1.8
"""Radius of the cut in radii of the EE: above 1 because the median of the visible points lies on the EE's near side,
off its origin.
"""
NEAR_QUANTILE = 0.2
"""At least this share of a mask's depths is assumed to be the tool; the rest may be background."""


@dataclass(frozen=True)
class EeCloud:
    """The clouds of one detection, or the reason why there are none.

    Attributes:
        points: Measured points of the EE, (N, 3) [m], camera frame; empty when not usable.
        rest: Visible points of the rest of the tool, (M, 3) [m], camera frame.
        completed: Points of mask pixels without measured depth, at the completed depth, (G, 3) [m], camera frame.
        reason: "ok", or why there is no cloud.
    """

    points: Array
    rest: Array
    completed: Array
    reason: str = "ok"

    @classmethod
    def refused(cls, reason: str) -> EeCloud:
        """An empty cloud with the reason why it is not usable."""
        nothing = np.empty((0, 3))
        return cls(nothing, nothing, nothing, reason)

    @property
    def usable(self) -> bool:
        """Whether there is a cloud to estimate a pose from."""
        return self.reason == "ok"


def check_depth_unit(depth: NDArray[np.floating]) -> None:
    """Check that a depth image can be in metres; one without any known depth passes.

    Args:
        depth: Depth (H, W) [m]; 0, NaN or infinite where unknown.

    Raises:
        UserError: Depths are negative, or their median is outside of 0.01 to 20 m.
    """
    known = depth[np.isfinite(depth) & (depth != 0)]
    if known.size == 0:
        return
    if (known < 0).any():
        raise UserError(
            "depth holds negative values: it must be the distance along the optical axis in metres",
            code="user.depth_negative",
        )
    median = float(np.median(known[:: max(1, known.size // 20000)]))
    if median > FARTHEST:
        raise UserError(
            f"median depth is {median:.0f} m: the depth scale is too large, pass the metres of one unit (--depth-scale "
            "0.001 for millimetres, 0.0001 for tenths)",
            code="user.depth_unit",
        )
    if median < 0.01:
        raise UserError(
            f"median depth is {1000 * median:.3g} mm: the depth scale is too small, pass the metres of one unit "
            "(--depth-scale 1 for metres, 0.001 for millimetres)",
            code="user.depth_unit",
        )


def back_project(depth: NDArray[np.floating], mask: NDArray[np.bool_], intrinsics: CameraIntrinsics) -> Array:
    """Back-project the pixels of a mask with the pinhole model.

    Args:
        depth: Depth (H, W) [m] along the optical axis.
        mask: Pixels (H, W) to take; those without a finite positive depth are skipped.
        intrinsics: Pinhole intrinsics [px].

    Returns:
        Points (N, 3) [m], camera frame.
    """
    v, u = np.nonzero(mask)
    z = depth[v, u].astype(np.float64)
    good = np.isfinite(z) & (z > 0)
    u, v, z = u[good], v[good], z[good]
    return z[:, None] * intrinsics.rays(np.stack([u, v], axis=-1))


def without_flying_pixels(depth: NDArray[np.floating], mask: NDArray[np.bool_], least: int = 2) -> NDArray[np.bool_]:
    """Remove pixels that lie between two surfaces (flying pixels, mixed depth at edges).

    Args:
        depth: Depth (H, W) [m].
        mask: Pixels (H, W) to clean.
        least: A pixel is kept if at least so many of its eight neighbours, inside or outside of the mask, have a depth
            within `surface_step` of its own.

    Returns:
        The cleaned mask (H, W).
    """
    rows, columns = np.nonzero(mask)
    if rows.size == 0:
        return mask
    r0, r1 = max(rows.min() - 1, 0), rows.max() + 2
    c0, c1 = max(columns.min() - 1, 0), columns.max() + 2
    z = np.nan_to_num(depth[r0:r1, c0:c1].astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    padded = np.pad(z, 1)
    near = np.zeros(z.shape, dtype=np.int32)
    limit = surface_step(z)
    height, width = z.shape
    for dy in (0, 1, 2):
        for dx in (0, 1, 2):
            if (dy, dx) != (1, 1):
                near += np.abs(padded[dy : dy + height, dx : dx + width] - z) < limit
    out = np.zeros_like(mask)
    out[r0:r1, c0:c1] = mask[r0:r1, c0:c1] & (z > 0) & (near >= least)
    return out


def trim(points: Array, radius: float) -> Array:
    """Remove points that are farther than a radius from the end effector.

    The centre starts at the near part of the depths (the mask of a thin tool is mostly the background behind it) and
    moves to the median of the points around it.

    Args:
        points: Points (N, 3) [m], camera frame.
        radius: Radius [m] of the sphere to keep.

    Returns:
        The points inside of the sphere, (K, 3) [m].
    """
    if len(points) == 0:
        return points
    near = points[points[:, 2] <= np.quantile(points[:, 2], NEAR_QUANTILE) + 0.5 * radius]
    centre = np.array([*np.median(near[:, :2], axis=0), np.quantile(points[:, 2], NEAR_QUANTILE)])
    for _ in range(2):
        inside = np.linalg.norm(points - centre, axis=1) < radius
        if not inside.any():
            return points[:0]
        centre = np.median(points[inside], axis=0)
    return points[np.linalg.norm(points - centre, axis=1) < radius]


def ee_cloud(frame: RgbdFrame, detection: Detection) -> EeCloud:
    """Extract the cleaned cloud of a detected end effector.

    Nearly every pixel of a thin tool is at an edge: where cleaning would leave too few points, the uncleaned ones are
    used.

    Args:
        frame: The frame in which the EE was detected.
        detection: The EE's mask, and the mask of its tool where seen.

    Returns:
        The EE's cloud, the rest of the tool and the completed points; not usable, with the reason, when fewer than
        `MIN_POINTS` mask pixels have depth.
    """
    radius = TRIM_RADII * detection.category.spec.radius
    measured = detection.mask & np.isfinite(frame.depth) & (frame.depth > 0)
    points = back_project(frame.depth, measured, frame.intrinsics)
    if len(points) < MIN_POINTS:
        seen = int(np.count_nonzero(detection.mask))
        return EeCloud.refused(
            f"only {len(points)} of {seen} mask pixels have depth, {MIN_POINTS} are needed: move the camera closer"
        )
    clean = without_flying_pixels(frame.depth, detection.mask)
    cleaned = trim(back_project(frame.depth, clean, frame.intrinsics), radius)
    if len(cleaned) >= MIN_POINTS:
        points, measured = cleaned, clean
    centre = np.median(points, axis=0)
    completed = completed_points(frame, detection.mask, measured)
    completed = completed[np.linalg.norm(completed - centre, axis=1) < radius]
    return EeCloud(points, rest_of_tool(frame, detection, centre), completed)


def completed_points(frame: RgbdFrame, mask: NDArray[np.bool_], measured: NDArray[np.bool_]) -> Array:
    """Points of the mask's pixels without a measured depth, at the depth completed from their neighbours.

    Args:
        frame: The frame of the mask.
        mask: The EE's mask (H, W).
        measured: Pixels (H, W) with a measured depth.

    Returns:
        Points (G, 3) [m], camera frame.
    """
    rows, columns = np.nonzero(mask)
    top, left, bottom, right = rows.min(), columns.min(), rows.max() + 1, columns.max() + 1
    window = np.s_[top:bottom, left:right]
    known = measured[window]
    depth, seen, wanted = (
        torch.from_numpy(np.ascontiguousarray(x))[None]
        for x in (frame.depth[window].astype(np.float32), known, mask[window] & ~known)
    )
    completed = complete_depth(depth, seen, wanted)[0].numpy()
    K, (height, width) = frame.intrinsics, completed.shape
    return back_project(completed, completed > 0, CameraIntrinsics(K.fx, K.fy, K.cx - left, K.cy - top, width, height))


def rest_of_tool(frame: RgbdFrame, detection: Detection, centroid: Array) -> Array:
    """Visible points of the detection's tool that do not belong to its end effector.

    Args:
        frame: The frame of the detection.
        detection: The EE with its tool's mask.
        centroid: Centre (3,) [m] of the EE's points, camera frame; points farther from it than `REST_REACH` are
            discarded.

    Returns:
        Points (M, 3) [m], camera frame; empty where no tool was detected.
    """
    if detection.tool_mask is None:
        return np.empty((0, 3))
    rest = without_flying_pixels(frame.depth, detection.tool_mask & ~detection.mask)
    points = back_project(frame.depth, rest, frame.intrinsics)
    return points[np.linalg.norm(points - centroid, axis=1) < REST_REACH]
