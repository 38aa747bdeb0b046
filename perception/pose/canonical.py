"""The canonical view of a cloud: outliers trimmed, centred, rotated so that the ray to its centre is z, 512 points.

Beside it, in the same frame, is a coarser cloud of the rest of the tool. Pixels of a mask without measured depth take
it from their measured neighbours; these points are among the 512 and marked. A camera loses shiny, steep and edge
pixels: in `hard` scenes 32 % of the EEs' pixels, three quarters of them within two pixels of the outline.

Centring keeps the working distance out of the network; rotating makes the result independent of the EE's place in the
image. These functions work on batches, for training on a GPU; `canonicalize_one` does the same in numpy for the single
cloud of an estimate, with lower latency: the same random numbers give the same result up to rounding, as a test
compares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from toolee_robot.frames import Array

RINGS = 3
"""Pixels up to so far from a measured one are completed; farther ones would be extrapolated."""
_STEP, _RELATIVE_STEP = 0.012, 0.01
_Depth = TypeVar("_Depth", Tensor, NDArray[np.float32])


def surface_step(depth: _Depth) -> _Depth:
    """Largest depth difference [m] between neighbouring pixels of one surface at `depth` [m]: 12 mm + 1 %."""
    return _STEP + _RELATIVE_STEP * depth


def complete_depth(depth: Tensor, known: Tensor, wanted: Tensor, rings: int = RINGS) -> Tensor:
    """Complete the depth of pixels without a measurement.

    Ring by ring, an unknown pixel takes the mean of the nearest surface among its eight neighbours: those within
    `surface_step` of the nearest one, so that a pixel on the outline belongs to the tool and not to the background.

    Args:
        depth: (B, H, W) [m], valid at the known pixels.
        known: Pixels with a measured depth, (B, H, W) bool.
        wanted: Pixels to complete, (B, H, W) bool.
        rings: Largest distance [px] from a known pixel.

    Returns:
        Completed depths (B, H, W) [m]; 0 elsewhere and where no known pixel is within reach.
    """
    height, width = depth.shape[-2:]
    z = torch.where(known, depth, torch.inf)
    for _ in range(rings):
        padded = F.pad(z, (1, 1, 1, 1), value=torch.inf)
        around = torch.stack([padded[:, i : i + height, j : j + width] for i in range(3) for j in range(3)], 1)
        nearest = around.min(1, keepdim=True)[0]
        same = around < nearest + surface_step(nearest)
        mean = torch.where(same, around, 0.0).sum(1) / same.sum(1).clamp(min=1)
        z = torch.where(wanted & torch.isinf(z) & torch.isfinite(nearest[:, 0]), mean, z)
    return torch.where(wanted & ~known & torch.isfinite(z), z, 0.0)


POINTS = 512
"""Points that the network sees; where there are fewer, they are repeated. 1024 give no better accuracy."""
PATCHES = 64
"""The first so many points are farthest-point samples: the centres of the patches."""
MIN_POINTS = 25
"""Least number of visible points for an estimate. The data sets require 50 per EE, of which a mask may show half."""
MIN_KEPT = 15
"""Least number of points that must be left after the outliers are removed."""
REST_POINTS = 256
"""Points of the rest of the tool that the network sees."""
REST_PATCHES = 32
"""The first so many of them are farthest-point samples."""
REST_REACH = 0.5
"""Longest tool [m]: points farther from the EE are background in the mask."""
REST_MIN = 20
"""Least number of points of the rest of the tool that are used."""


@dataclass(frozen=True)
class CanonicalCloud:
    """A batch of B canonical clouds.

    Attributes:
        points: (B, N, 3) [m], canonical frame.
        completed: (B, N), 1 where a point's depth is completed, else 0.
        centre: Origin of the canonical frame, (B, 3) [m], camera frame.
        R: Rotation, (B, 3, 3): p_canonical = R @ (p_camera - centre).
        count: Measured points that survived the trimming, (B,).
        rest: Points of the tool beyond its EE, (B, 256, 3) [m], canonical frame; zeros where unknown, see `with_rest`.
        rest_known: Whether the rest is known, (B,) bool.
    """

    points: Tensor
    completed: Tensor
    centre: Tensor
    R: Tensor
    count: Tensor
    rest: Tensor
    rest_known: Tensor


def canonicalize(
    points: Tensor,
    valid: Tensor,
    radius: Tensor,
    generator: torch.Generator | None = None,
    size: int = POINTS,
    ordered: int = PATCHES,
    completed: tuple[Tensor, Tensor] | None = None,
) -> CanonicalCloud:
    """Make canonical clouds of clouds in the camera frame.

    The mask of a thin tool is mostly background, so the centre starts at the 30 % quantile of the depth, moves to the
    median of the points near it, and outliers are cut around that.

    Args:
        points: (B, N, 3) [m], camera frame.
        valid: Which points are real, (B, N) bool.
        radius: Radius [m] of each EE, (B,).
        generator: Draws the points; on the same device as they are.
        size: Points of each result.
        ordered: The first so many of them are farthest-point samples.
        completed: Points (B, M, 3) [m] of completed depth and their mask (B, M); they do not move the centre.

    Returns:
        The canonical clouds, the rest of the tool unknown.
    """
    radius = radius[:, None]
    z = points[..., 2]
    z30 = _masked_quantile(points[..., 2:], valid, 0.3)
    near = valid & ((z - z30).abs() < 1.6 * radius)
    centre = masked_median(points, near)
    kept = valid & ((points - centre[:, None]).norm(dim=-1) < 1.8 * radius)
    centre = masked_median(points, kept)
    kept = valid & ((points - centre[:, None]).norm(dim=-1) < 1.6 * radius)
    count = kept.sum(1)
    R = ray_rotation(centre)
    marks = torch.zeros_like(points[..., :1])
    if completed is not None:
        more, real = completed
        points = torch.cat([points, more], 1)
        marks = torch.cat([marks, torch.ones_like(more[..., :1])], 1)
        kept = torch.cat([kept, real & ((more - centre[:, None]).norm(dim=-1) < 1.6 * radius)], 1)
    total = kept.sum(1)
    # Random order with the real points first; then repeat them up to `size`.
    key = torch.rand(kept.shape, device=points.device, generator=generator) + (~kept).float() * 2
    order = key.argsort(1)
    pick = torch.arange(size, device=points.device)[None] % total.clamp(1, size)[:, None]
    chosen = _rows(torch.cat([points, marks], -1), order.gather(1, pick))
    # A cloud without any kept point becomes its centre: it is refused later, but must stay finite.
    offset = torch.where((count > 0)[:, None, None], chosen[..., :3] - centre[:, None], 0.0)
    local = torch.cat([torch.einsum("bij,bnj->bni", R, offset), chosen[..., 3:]], -1)
    rest = local.new_zeros(len(local), REST_POINTS, 3)
    unknown = torch.zeros(len(local), dtype=torch.bool, device=local.device)
    local = farthest_points_first(local, ordered)
    return CanonicalCloud(local[..., :3].contiguous(), local[..., 3].contiguous(), centre, R, count, rest, unknown)


def with_rest(
    cloud: CanonicalCloud, points: Tensor, valid: Tensor, generator: torch.Generator | None = None
) -> CanonicalCloud:
    """Add the visible rest of the tool to canonical clouds.

    Args:
        cloud: The canonical clouds, a batch of B.
        points: Points of the rest of each tool, (B, M, 3) [m], camera frame.
        valid: Which of them are real, (B, M) bool.
        generator: Draws the points; on the same device as they are.

    Returns:
        The clouds with `rest`; it stays unknown where fewer than `REST_MIN` points lie within `REST_REACH`.
    """
    if not points.shape[1]:
        return cloud
    offset = points - cloud.centre[:, None]
    kept = valid & (offset.norm(dim=-1) < REST_REACH)
    count = kept.sum(1)
    known = count >= REST_MIN
    key = torch.rand(valid.shape, device=points.device, generator=generator) + (~kept).float() * 2
    pick = torch.arange(REST_POINTS, device=points.device)[None] % count.clamp(1, REST_POINTS)[:, None]
    chosen = torch.einsum("bij,bnj->bni", cloud.R, _rows(offset, key.argsort(1).gather(1, pick)))
    rest = farthest_points_first(torch.where(known[:, None, None], chosen, 0.0), REST_PATCHES)
    return replace(cloud, rest=rest, rest_known=known)


def ray_rotation(centre: Tensor) -> Tensor:
    """The smallest rotation that turns the ray to a point onto the z axis.

    Args:
        centre: Points (B, 3) [m] in front of the camera.

    Returns:
        Rotations (B, 3, 3).
    """
    d = centre / centre.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    x, y, c = d[:, 0], d[:, 1], d[:, 2]
    k = 1 / (1 + c).clamp_min(1e-6)
    rows = [1 - k * x * x, -k * x * y, -x, -k * x * y, 1 - k * y * y, -y, x, y, c]
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def farthest_points_first(points: Tensor, count: int) -> Tensor:
    """Reorder points so that farthest-point samples come first.

    Args:
        points: (B, N, 3 or more); further columns stay with their points.
        count: Number of farthest-point samples; the first is the point farthest from the origin.

    Returns:
        The same points, reordered, (B, N, ...).
    """
    places = points[..., :3]
    if points.device.type == "cpu":
        picked = torch.from_numpy(np.stack([farthest_of_one(p, count) for p in places.numpy()]))
    else:
        picked = _farthest_of_batch(places, count)
    rank = torch.arange(count, 0, -1, device=points.device).expand(len(points), -1)
    taken = rank.new_zeros(points.shape[:2]).scatter_(1, picked, rank)
    return _rows(points, taken.argsort(dim=1, descending=True, stable=True))


def _farthest_of_batch(places: Tensor, count: int) -> Tensor:
    """(B, count) indices of farthest-point samples of (B, N, 3)."""
    distance = torch.full(places.shape[:2], torch.inf, device=places.device)
    index = places.square().sum(-1).argmax(1, keepdim=True)
    picked = []
    for _ in range(count):
        picked.append(index)
        distance = torch.minimum(distance, (places - _rows(places, index)).square_().sum(-1))
        # Repeated points have distance 0; prefer any point not taken yet over one that is.
        distance.scatter_(1, index, -1.0)
        index = distance.argmax(1, keepdim=True)
    return torch.cat(picked, 1)


def farthest_of_one(places: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """Farthest-point samples of one cloud, in numpy: for one cloud torch's dispatch costs several times the arithmetic.

    Args:
        places: Points (N, 3) [m].
        count: Number of samples.

    Returns:
        Indices (count,), the point farthest from the origin first.
    """
    x, n = places.T.astype(np.float64), len(places)
    squared = (x * x).sum(0)
    # |p - x|^2 = |p|^2 - 2 p.x + |x|^2 of all points with one of them is one product of a row with a matrix; in double
    # precision, because single precision loses small distances to cancellation.
    row, matrix = np.ones((n, 5)), np.ones((5, n))
    row[:, :3], row[:, 4] = -2 * places, squared
    matrix[:3], matrix[3] = x, squared
    index = int(squared.argmax())
    rounding = 1e-14 * squared[index]
    distance, to_this = np.full(n, np.inf), np.empty(n)
    picked = np.empty(count, np.int64)
    for k in range(count):
        if distance[index] <= rounding:
            # The remaining points are repetitions of those taken.
            picked[k:] = np.flatnonzero(distance >= -rounding)[: count - k]
            break
        picked[k] = index
        row[index].dot(matrix, out=to_this)
        np.minimum(distance, to_this, out=distance)
        distance[index] = -1.0
        index = int(distance.argmax())
    return picked


def _rows(x: Tensor, index: Tensor) -> Tensor:
    return x.gather(1, index[..., None].expand(-1, -1, x.shape[-1]))


def _masked_quantile(x: Tensor, mask: Tensor, q: float) -> Tensor:
    """(B, C) quantile of each column of x (B, N, C) where mask (B, N); 0 where the mask is empty."""
    ordered = torch.where(mask[..., None], x, torch.inf).sort(1).values
    n = mask.sum(1)
    place = ((n - 1).clamp_min(0) * q).long()
    value = ordered.gather(1, place[:, None, None].expand(-1, 1, x.shape[-1]))[:, 0]
    return torch.where(n[:, None] > 0, value, 0.0)


def masked_median(x: Tensor, mask: Tensor) -> Tensor:
    """Median per coordinate over the masked points.

    Args:
        x: Points, (B, N, 3).
        mask: Points that count, (B, N) bool.

    Returns:
        The medians, (B, 3).
    """
    return _masked_quantile(x, mask, 0.5)


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
