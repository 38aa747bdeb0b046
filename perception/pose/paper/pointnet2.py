"""PointNet++ with multi-scale grouping in plain PyTorch: Qi et al., "PointNet++", NeurIPS 2017.

The sizes are those of the light classification network that GenPose and ToolEENet use, about 1.0 M parameters.
Farthest-point sampling has been done once, where the cloud is made: clouds come with their points in that order
(`canonical.farthest_points_first`), and the first n of them are the n farthest-point samples on every level.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class Level:
    """One set abstraction: `centres` of the points are kept (0: one for all points); balls of radii [m] with so many
    neighbours; channels of their shared MLPs."""

    centres: int
    radii: tuple[float, ...]
    neighbours: tuple[int, ...]
    channels: tuple[tuple[int, ...], ...]


LEVELS = (
    Level(512, (0.02, 0.04), (16, 32), ((16, 16, 32), (32, 32, 64))),
    Level(256, (0.04, 0.08), (16, 32), ((64, 64, 128), (64, 96, 128))),
    Level(128, (0.08, 0.16), (16, 32), ((128, 196, 256), (128, 196, 256))),
    Level(0, (), (), ((256, 256, 512), (256, 384, 512))),
)
ORDERED = LEVELS[0].centres


class PointNet2(nn.Module):
    """Feature (B, 1024) of clouds (B, N, 3) [m] whose first `levels[0].centres` points are farthest-point samples."""

    def __init__(self, levels: tuple[Level, ...] = LEVELS) -> None:
        super().__init__()
        self.levels = levels
        channels = 0
        stages = []
        for level in levels:
            stages.append(nn.ModuleList([_mlp(channels + 3, c) for c in level.channels]))
            channels = sum(c[-1] for c in level.channels)
        self.stages = nn.ModuleList(stages)
        self.size = channels

    def forward(self, points: Tensor) -> Tensor:
        """See the class."""
        feature: Tensor | None = None
        for level, stage in zip(self.levels, self.stages, strict=True):
            if level.centres == 0:
                grouped = points if feature is None else torch.cat([points, feature], dim=-1)
                return torch.cat([_apply(mlp, grouped[:, None])[:, 0] for mlp in _modules(stage)], dim=-1)
            centres = points[:, : level.centres]
            index, distance = ball_query(centres, points, max(level.neighbours))
            scales = []
            for mlp, radius, count in zip(_modules(stage), level.radii, level.neighbours, strict=True):
                # A neighbour outside of the ball is replaced by the nearest point, the centre itself.
                near = torch.where(distance[..., :count] < radius, index[..., :count], index[..., :1])
                offset = _rows(points, near) - centres[:, :, None]
                grouped = offset if feature is None else torch.cat([offset, _rows(feature, near)], dim=-1)
                scales.append(_apply(mlp, grouped))
            # In single precision: the gradient of a gather is a sum of many; bfloat16 loses small ones.
            points, feature = centres, torch.cat(scales, dim=-1).float()
        raise ValueError("the last level must take all points")


def ball_query(centres: Tensor, points: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The `count` nearest points of each centre, nearest first: index (B, C, count), distance [m] likewise."""
    with torch.no_grad():
        distance = torch.cdist(centres, points, compute_mode="donot_use_mm_for_euclid_dist")
        near, index = distance.topk(min(count, points.shape[1]), dim=-1, largest=False, sorted=True)
    return index, near


def _mlp(channels: int, sizes: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for size in sizes:
        layers += [nn.Conv2d(channels, size, 1, bias=False), nn.BatchNorm2d(size), nn.ReLU(inplace=True)]
        channels = size
    return nn.Sequential(*layers)


def _modules(stage: nn.Module) -> list[nn.Module]:
    return list(stage.children())


def _apply(mlp: nn.Module, grouped: Tensor) -> Tensor:
    """(B, C, n, channels) -> (B, C, out): the shared MLP, and its maximum over the n points of each group."""
    out: Tensor = mlp(grouped.permute(0, 3, 1, 2)).max(dim=3)[0]
    return out.transpose(1, 2)


def _rows(x: Tensor, index: Tensor) -> Tensor:
    """Rows (B, C, n, d) of x (B, N, d)."""
    flat = index.flatten(1)[..., None].expand(-1, -1, x.shape[-1])
    return x.gather(1, flat).view(*index.shape, x.shape[-1])
