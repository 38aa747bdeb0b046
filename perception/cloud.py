"""From a mask and a depth image to the clean partial cloud of an end effector, in the camera frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.perception.pose.canonical import MIN_POINTS, REST_MIN, REST_REACH
from toolee_robot.perception.pose.depth_completion import complete_depth, surface_step
from toolee_robot.types import CameraIntrinsics, Detection, RgbdFrame

NEAREST, FARTHEST = 0.05, 20.0
"""Depths [m] outside are not a tool in a hand before a depth camera."""
TRIM_RADII = 1.8
"""The visible points' median lies off the EE's origin, on its near side, so the cut is wider than the EE's area."""
NEAR_QUANTILE = 0.2
"""At least this share of a mask's depth is taken to be the tool, the rest may be background."""


@dataclass(frozen=True)
class EeCloud:
    """points (N, 3) [m], camera frame, or the reason why there are none.

    rest: (M, 3) [m], camera frame, the visible points of the rest of the tool. completed: (G, 3) [m], camera frame, the
    mask's pixels without a depth, at the one of their neighbours.
    """

    points: Array
    rest: Array
    completed: Array
    reason: str = "ok"

    @classmethod
    def refused(cls, reason: str) -> EeCloud:
        """No cloud."""
        nothing = np.empty((0, 3))
        return cls(nothing, nothing, nothing, reason)

    @property
    def direction(self) -> Array | None:
        """Unit vector (3,), camera frame, from the points' centroid to the rest of the tool; None where unseen."""
        if not self.usable or len(self.rest) < REST_MIN:
            return None
        to_rest = np.median(self.rest, axis=0) - self.points.mean(axis=0)
        norm = float(np.linalg.norm(to_rest))
        return to_rest / norm if norm > 0 else None

    @property
    def usable(self) -> bool:
        return self.reason == "ok"


def check_depth_unit(depth: NDArray[np.floating]) -> None:
    """Raise UserError when the depth cannot be in metres. Frames without any depth pass: they give no cloud."""
    known = depth[np.isfinite(depth) & (depth != 0)]
    if known.size == 0:
        return
    if (known < 0).any():
        raise UserError("depth holds negative values: it must be the distance along the optical axis in metres")
    median = float(np.median(known[:: max(1, known.size // 20000)]))
    if median > FARTHEST:
        raise UserError(f"median depth is {median:.0f} m: it looks like millimetres, pass --depth-scale 0.001")
    if median < 0.01:
        raise UserError(
            f"median depth is {1000 * median:.3g} mm: the depth scale is too small, pass the metres of one unit "
            "(--depth-scale 1 for metres, 0.001 for millimetres)"
        )


def back_project(depth: NDArray[np.floating], mask: NDArray[np.bool_], intrinsics: CameraIntrinsics) -> Array:
    """Points (N, 3) [m], camera frame, of the mask's pixels whose depth (H, W) [m] is finite and positive."""
    v, u = np.nonzero(mask)
    z = depth[v, u].astype(np.float64)
    good = np.isfinite(z) & (z > 0)
    u, v, z = u[good], v[good], z[good]
    x = (u - intrinsics.cx) / intrinsics.fx * z
    y = (v - intrinsics.cy) / intrinsics.fy * z
    return np.column_stack([x, y, z])


def without_flying_pixels(depth: NDArray[np.floating], mask: NDArray[np.bool_], least: int = 2) -> NDArray[np.bool_]:
    """The mask less pixels that hang between surfaces: fewer than `least` of the eight neighbours, anywhere in the
    image, have a depth within `surface_step` of theirs."""
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
    """Points within `radius` [m] of the EE: centred first on the near part of the depths (a thin tool's mask is mostly
    the background behind it), then on the median, then cut."""
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
    """The EE's cleaned cloud, or the reason why there is none.

    Of a thin tool nearly every pixel is at an edge: what cleaning would leave without an estimate stays as it is.
    """
    radius = TRIM_RADII * detection.category.spec.radius
    measured = detection.mask & np.isfinite(frame.depth) & (frame.depth > 0)
    points = back_project(frame.depth, measured, frame.intrinsics)
    if len(points) < MIN_POINTS:
        seen = int(np.count_nonzero(detection.mask))
        return EeCloud.refused(
            f"only {len(points)} of {seen} mask pixels have depth, {MIN_POINTS} are needed: look from nearer"
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
    """Points (G, 3) [m], camera frame, of the mask's pixels that are not measured, at the depth of their neighbours."""
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
    """Points (M, 3) [m], camera frame, of the detection's tool but not of its EE; none where no tool was found.

    centroid: (3,) of the EE's points; what is farther than any tool reaches is left out."""
    if detection.tool_mask is None:
        return np.empty((0, 3))
    rest = without_flying_pixels(frame.depth, detection.tool_mask & ~detection.mask)
    points = back_project(frame.depth, rest, frame.intrinsics)
    return points[np.linalg.norm(points - centroid, axis=1) < REST_REACH]
