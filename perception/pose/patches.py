"""Patch tokens of a cloud: a small PointNet (Qi et al., CVPR 2017) on the neighbourhood of each of its first points."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Patches(nn.Module):
    """A small PointNet on the neighbourhood of each of a cloud's first points.

    Args:
        width: Width of the tokens.
        count: Number of patches: the first so many points are their centres.
        neighbours: Points per patch.
        ball: Radius of a patch [m]; farther neighbours are replaced by the centre.
        scale: Scale [m] of the centres' coordinates.
        marked: Whether each point comes with a mark (1 channel).
    """

    def __init__(
        self, width: int, count: int, neighbours: int, ball: float, scale: float, marked: bool = False
    ) -> None:
        super().__init__()
        self._count, self._neighbours, self._ball, self._scale = count, neighbours, ball, scale
        self.inner = nn.Sequential(nn.Linear(3 + marked, width // 4), nn.SiLU(), nn.Linear(width // 4, width // 2))
        self.outer = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.place = nn.Sequential(nn.Linear(3, width // 2), nn.SiLU(), nn.Linear(width // 2, width))

    def forward(self, points: Tensor, marks: Tensor | None = None, mirror: bool = False) -> Tensor:
        """Tokens of a cloud's patches.

        Args:
            points: (B, N, 3) [m], the patches' centres first.
            marks: (B, N), where the points are marked.
            mirror: Whether to add the mirror image in x; its neighbourhoods are the same.

        Returns:
            (B, count, width); with `mirror` (2 B, count, width).
        """
        centres = points[:, : self._count]
        patches = self._patches(centres, points, marks)
        if mirror:
            centres, patches = (torch.cat([x, mirror_x(x)]) for x in (centres, patches))
        h = self.inner(patches)
        # In training max(dim): under torch.compile in bfloat16 the gradient of amax, which is faster, was not finite.
        pooled = h.max(2)[0] if self.training else h.amax(2)
        tokens: Tensor = self.outer(torch.cat([pooled, _mean(h)], dim=-1)) + self.place(centres / self._scale)
        return tokens

    @torch.no_grad()
    def _patches(self, centres: Tensor, points: Tensor, marks: Tensor | None) -> Tensor:
        """Patches (B, count, neighbours, 3 or 4) relative to their centres, in radii of the ball; the mark last."""
        # Summed per coordinate: a reduction over an axis of three takes 2.5 times as long.
        x, y, z = ((centres[:, :, None, k] - points[:, None, :, k]).square() for k in range(3))
        squared = x + y + z
        near, index = squared.topk(self._neighbours, dim=-1, largest=False, sorted=False)
        rows = index.flatten(1)[..., None].expand(-1, -1, 3)
        patches = points.gather(1, rows).view(*index.shape, 3) - centres[:, :, None]
        # A neighbour outside of the ball is replaced by the centre itself.
        inside = near < self._ball**2
        patches = torch.where(inside[..., None], patches, 0.0) / self._ball
        if marks is None:
            return patches
        own = marks[:, : self._count, None]
        mark = torch.where(inside, marks.gather(1, index.flatten(1)).view(index.shape), own)
        return torch.cat([patches, mark[..., None]], -1)


def _mean(h: Tensor) -> Tensor:
    """Mean of h (B, count, neighbours, width) over the neighbours; in bfloat16 on a CPU as a product (faster)."""
    if h.device.type != "cpu" or h.dtype is not torch.bfloat16:
        return h.mean(2)
    share = h.new_full((1, h.shape[2]), 1.0 / h.shape[2])
    return (share @ h)[:, :, 0]


def mirror_x(x: Tensor) -> Tensor:
    """Mirror vectors (..., 3 or more) in x."""
    return torch.cat([-x[..., :1], x[..., 1:]], -1)
