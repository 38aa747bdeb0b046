"""The canonical view of a single cloud, in numpy: as `canonical.py` for batches, with lower latency.

The same random numbers give the same result up to rounding; a test compares the two.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.perception.pose.canonical import (
    PATCHES,
    POINTS,
    REST_MIN,
    REST_PATCHES,
    REST_POINTS,
    REST_REACH,
    CanonicalCloud,
    farthest_of_one,
)

_Float32 = NDArray[np.float32]
_Bool = NDArray[np.bool_]


def canonicalize_one(
    points: Array,
    radius: float,
    generator: torch.Generator,
    size: int = POINTS,
    ordered: int = PATCHES,
    completed: Array | None = None,
) -> CanonicalCloud:
    """Make the canonical cloud of one cloud; see `canonicalize`.

    Args:
        points: (N, 3) [m], camera frame, N > 0.
        radius: Radius [m] of the EE.
        generator: Draws the points; on the CPU.
        size: Points of the result.
        ordered: The first so many of them are farthest-point samples.
        completed: Points (M, 3) [m] of completed depth.

    Returns:
        A batch of one.
    """
    xyz = _columns(points)
    near = np.abs(xyz[2:] - _quantile(xyz[2:], 0.3))[0] < 1.6 * radius
    centre = _quantile(xyz.compress(near, axis=1), 0.5)
    centre = _quantile(xyz.compress(_within(xyz - centre, 1.8 * radius), axis=1), 0.5)
    offset = xyz - centre
    kept = _within(offset, 1.6 * radius)
    count = int(np.count_nonzero(kept))
    if completed is not None:
        more = _columns(completed) - centre
        offset = np.concatenate([offset, more], axis=1)
        kept = np.concatenate([kept, _within(more, 1.6 * radius)])
    pick = _drawn(kept, size, generator)
    R = _ray_rotation(centre)
    local = _turned(offset, R, pick) if count else np.zeros((size, 3), np.float32)
    order = _farthest_first(local, ordered)
    marks = (pick[order] >= len(points)).astype(np.float32)
    return CanonicalCloud(
        points=torch.from_numpy(local[order])[None],
        completed=torch.from_numpy(marks)[None],
        centre=torch.from_numpy(centre.T),
        R=torch.from_numpy(R)[None],
        count=torch.tensor([count]),
        rest=torch.zeros(1, REST_POINTS, 3),
        rest_known=torch.zeros(1, dtype=torch.bool),
    )


def with_rest_one(cloud: CanonicalCloud, points: Array, generator: torch.Generator) -> CanonicalCloud:
    """Add the visible rest of the tool to a canonical cloud; see `with_rest`.

    Args:
        cloud: A batch of one.
        points: Points (M, 3) [m] of the rest, camera frame.
        generator: Draws the points; on the CPU.

    Returns:
        The cloud with `rest`.
    """
    if not len(points):
        return cloud
    offset = _columns(points) - cloud.centre.numpy().T
    kept = _within(offset, REST_REACH)
    pick = _drawn(kept, REST_POINTS, generator)
    if np.count_nonzero(kept) < REST_MIN:
        return cloud
    local = _turned(offset, cloud.R[0].numpy(), pick)
    rest = torch.from_numpy(local[_farthest_first(local, REST_PATCHES)])[None]
    return replace(cloud, rest=rest, rest_known=torch.ones(1, dtype=torch.bool))


def _columns(points: Array) -> _Float32:
    """Points as contiguous columns (3, N)."""
    return np.ascontiguousarray(points.T, dtype=np.float32)


def _within(offset: _Float32, reach: float) -> _Bool:
    """Which of the offsets (3, N) are shorter than `reach`, (N,)."""
    return (offset * offset).sum(0) < np.float32(reach) ** 2


def _quantile(x: _Float32, q: float) -> _Float32:
    """Quantile of each row of x (C, N), (C, 1); 0 of an empty row."""
    n = x.shape[1]
    if not n:
        return np.zeros((len(x), 1), np.float32)
    place = int((n - 1) * q)
    return np.partition(x, place, axis=1)[:, place, None]


def _drawn(kept: _Bool, size: int, generator: torch.Generator) -> NDArray[np.intp]:
    """Indices (size,) of kept elements (N,) in random order, repeated if there are fewer; 0 if there are none."""
    key = torch.rand(len(kept), generator=generator).numpy()
    places = np.flatnonzero(kept)
    if not len(places):
        return np.zeros(size, np.intp)
    return places[key[places].argsort(kind="stable")].take(np.arange(size), mode="wrap")


def _ray_rotation(centre: _Float32) -> _Float32:
    """`ray_rotation` of one centre (3, 1): (3, 3)."""
    x, y, z = centre[:, 0].tolist()
    norm = max((x * x + y * y + z * z) ** 0.5, 1e-9)
    x, y, c = x / norm, y / norm, z / norm
    k = 1 / max(1 + c, 1e-6)
    rows = [[1 - k * x * x, -k * x * y, -x], [-k * x * y, 1 - k * y * y, -y], [x, y, c]]
    return np.array(rows, np.float32)


def _turned(offset: _Float32, R: _Float32, pick: NDArray[np.intp]) -> _Float32:
    """The picked offsets (3, N), rotated by R (3, 3): (size, 3)."""
    return np.ascontiguousarray((R @ offset.take(pick, axis=1)).T)


def _farthest_first(local: _Float32, count: int) -> NDArray[np.intp]:
    """Order (N,) in which `farthest_points_first` puts points (N, 3)."""
    picked = farthest_of_one(local, count)
    left = np.ones(len(local), dtype=bool)
    left[picked] = False
    return np.concatenate([picked, np.flatnonzero(left)])
