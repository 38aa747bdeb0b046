"""The canonical view of a cloud: outliers trimmed, centred, turned so that the ray to its centre is z, 512 points;
beside it, in the same frame, a coarse cloud of what else is seen of the tool. Points whose depth was completed
(`depth_completion.py`) are among the 512, marked.

Centring keeps the working distance out of the network, turning makes the result independent of where in the image the
EE stands. Here for batches, as training has them on the GPU; `canonical_single.py` does the same to the one cloud of an
estimate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

POINTS = 512
"""Points the network sees; fewer are repeated. 1024 measured no better."""
PATCHES = 64
"""The first this many points are farthest-point samples: the patches' centres."""
MIN_POINTS = 25
"""Fewer visible points give no estimate. The data sets ask for ends of 50, but of these a mask may show half."""
MIN_KEPT = 15
"""Nor do fewer that are left without the outliers."""
REST_POINTS = 256
"""Points of the rest of the tool that the network sees."""
REST_PATCHES = 32
"""The first this many of them are farthest-point samples."""
REST_REACH = 0.5
"""No tool of these is longer [m]: farther points are background that the mask caught."""
REST_MIN = 20
"""Fewer points of the rest say nothing."""


@dataclass(frozen=True)
class CanonicalCloud:
    """points: (B, N, 3) [m], canonical frame; completed: (B, N), 1 where a point's depth is completed, else 0. centre:
    (B, 3) [m] and R: (B, 3, 3) with p_canonical = R @ (p_camera - centre). count: (B,) measured points that survived
    the trimming. rest: (B, 256, 3) [m] of the tool beyond its EE, canonical frame, zeros where rest_known (B,) is not;
    see `with_rest`."""

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
    """Clouds (B, N, 3) [m] in the camera frame with a mask (B, N) of real points -> canonical clouds.

    radius: (B,) [m] of the EE's area. A dilated mask on a thin tool is mostly background, so the centre starts at the
    30 % quantile of the depth, then is the median of what lies near, then outliers are cut. The generator draws the
    points; it lives on the same device as the points. size: points of the result, of which the first `ordered` are
    farthest-point samples. completed: points (B, M, 3) [m] and mask (B, M), likewise, of a completed depth; they do not
    move the centre.
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
    # A cloud that lost everything becomes its centre: it is refused later, but must stay finite.
    offset = torch.where((count > 0)[:, None, None], chosen[..., :3] - centre[:, None], 0.0)
    local = torch.cat([torch.einsum("bij,bnj->bni", R, offset), chosen[..., 3:]], -1)
    rest = local.new_zeros(len(local), REST_POINTS, 3)
    unknown = torch.zeros(len(local), dtype=torch.bool, device=local.device)
    local = farthest_points_first(local, ordered)
    return CanonicalCloud(local[..., :3].contiguous(), local[..., 3].contiguous(), centre, R, count, rest, unknown)


def with_rest(
    cloud: CanonicalCloud, points: Tensor, valid: Tensor, generator: torch.Generator | None = None
) -> CanonicalCloud:
    """The cloud with what else is seen of its tools: points (B, M, 3) [m], camera frame, with a mask (B, M).

    Of fewer than 20 points within 0.5 m nothing is taken.
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
    """The smallest rotation (B, 3, 3) that turns the ray to `centre` (B, 3), in front of the camera, onto z."""
    d = centre / centre.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    x, y, c = d[:, 0], d[:, 1], d[:, 2]
    k = 1 / (1 + c).clamp_min(1e-6)
    rows = [1 - k * x * x, -k * x * y, -x, -k * x * y, 1 - k * y * y, -y, x, y, c]
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def farthest_points_first(points: Tensor, count: int) -> Tensor:
    """The same points (B, N, 3), reordered: `count` farthest-point samples first, from the point farthest from 0.
    More columns than three travel with their points."""
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
    """The same (count,) of one cloud (N, 3). For the latency of a single estimate: torch's dispatch takes several times
    as long as the arithmetic."""
    x, n = places.T.astype(np.float64), len(places)
    squared = (x * x).sum(0)
    # |p - x|^2 = |p|^2 - 2 p.x + |x|^2 of all points with one of them is one product of a row with a matrix; in double
    # precision, for single would lose what is near.
    row, matrix = np.ones((n, 5)), np.ones((5, n))
    row[:, :3], row[:, 4] = -2 * places, squared
    matrix[:3], matrix[3] = x, squared
    index = int(squared.argmax())
    rounding = 1e-14 * squared[index]
    distance, to_this = np.full(n, np.inf), np.empty(n)
    picked = np.empty(count, np.int64)
    for k in range(count):
        if distance[index] <= rounding:
            # All that is left repeats points that are taken.
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
    """(B, 3) median per coordinate of x (B, N, 3) where mask."""
    return _masked_quantile(x, mask, 0.5)
