"""The paper's network: PointNet++ with multi-scale grouping, and a noise-conditional score network on its feature.

The sizes are those of the light classification network that GenPose and ToolEENet use, about 1.0 M parameters, but
200 channels instead of 196: tensor cores take multiples of eight. Farthest-point sampling is done once, when the cloud
is made: clouds come with their points in that order (`canonical.farthest_points_first`), and the first n of them are
the n farthest-point samples on every level. The balls' points can be found once, too (`PointNet2.neighbours`). As in
the published code a ball's points are the first ones within its radius, not the nearest: on the first level in random
order, then in that of the farthest-point samples, so that few points span the ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.end_effectors import Category


@dataclass(frozen=True)
class Level:
    """One set abstraction level.

    Attributes:
        centres: Points that are kept; 0: one group of all points.
        radii: Radii of the balls [m].
        neighbours: Points per ball.
        channels: Channels of each ball's shared MLP.
    """

    centres: int
    radii: tuple[float, ...]
    neighbours: tuple[int, ...]
    channels: tuple[tuple[int, ...], ...]


LEVELS = (
    Level(512, (0.02, 0.04), (16, 32), ((16, 16, 32), (32, 32, 64))),
    Level(256, (0.04, 0.08), (16, 32), ((64, 64, 128), (64, 96, 128))),
    Level(128, (0.08, 0.16), (16, 32), ((128, 200, 256), (128, 200, 256))),
    Level(0, (), (), ((256, 256, 512), (256, 384, 512))),
)
ORDERED = LEVELS[0].centres
POINTS = 1024
"""Points of a cloud."""


class PointNet2(nn.Module):
    """PointNet++ encoder.

    Args:
        levels: The set abstraction levels; the last one takes all points.

    Attributes:
        size: Width of the feature.
        order: The order, a random one, in which the first level's balls take points, (`POINTS`,).
    """

    order: Tensor

    def __init__(self, levels: tuple[Level, ...] = LEVELS) -> None:
        super().__init__()
        self.levels = levels
        self.register_buffer("order", torch.randperm(POINTS, generator=torch.Generator().manual_seed(0)))
        channels = 0
        stages = []
        for level in levels:
            stages.append(nn.ModuleList([SharedMlp(channels, c) for c in level.channels]))
            channels = sum(c[-1] for c in level.channels)
        self.stages = nn.ModuleList(stages)
        self.size = channels

    def forward(self, points: Tensor, neighbours: Sequence[Tensor] | None = None) -> Tensor:
        """Encode clouds.

        Args:
            points: (B, N, 3) [m]; the first `levels[0].centres` are farthest-point samples.
            neighbours: What the method of this name gives for them; None: found now.

        Returns:
            Feature (B, size).
        """
        balls = [*(self.neighbours(points) if neighbours is None else neighbours)]
        feature: Tensor | None = None
        for level, stage in zip(self.levels[:-1], self.stages, strict=False):
            centres = points[:, : level.centres]
            scales = []
            for mlp in _modules(stage):
                near = balls.pop(0)
                scales.append(mlp(_rows(points, near) - centres[:, :, None], feature, near))
            points, feature = centres, torch.cat(scales, dim=-1)
        return torch.cat([mlp(points[:, None], feature, None)[:, 0] for mlp in _modules(self.stages[-1])], dim=-1)

    @torch.no_grad()
    def neighbours(self, points: Tensor) -> list[Tensor]:
        """The points of all balls; they depend on the cloud alone.

        Args:
            points: As in `forward`.

        Returns:
            Indices (B, C, n) int16, one tensor for each radius of each level.
        """
        found = []
        order = self.order[self.order < points.shape[1]]
        for level in self.levels[:-1]:
            centres = points[:, : level.centres]
            for radius, count in zip(level.radii, level.neighbours, strict=True):
                found.append(order[ball_query(centres, points[:, order], radius, count)].short())
            points, order = centres, torch.arange(level.centres, device=points.device)
        return found


class SharedMlp(nn.Module):
    """MLP shared by the points of all groups, with batch normalisation, then the maximum of each group.

    Its first layer is applied to the features before they are gathered, once per point instead of once per group that
    the point is in: the same sums, with a tenth of the arithmetic.

    Args:
        channels: Channels of the features, which come after a point's three coordinates.
        sizes: Widths of the layers.
    """

    def __init__(self, channels: int, sizes: tuple[int, ...]) -> None:
        super().__init__()
        inputs = (channels + 3, *sizes)
        self.linears = nn.ModuleList([nn.Linear(a, b, bias=False) for a, b in pairwise(inputs)])
        self.norms = nn.ModuleList([nn.BatchNorm1d(size) for size in sizes])

    def forward(self, offsets: Tensor, features: Tensor | None, near: Tensor | None) -> Tensor:
        """Features of groups.

        Args:
            offsets: Offsets (B, C, n, 3) [m] of the n points of each group from its centre.
            features: Features (B, N, channels) of all points; None on the first level.
            near: Indices (B, C, n) of the groups' points; None: all points, in one group.

        Returns:
            (B, C, out).
        """
        (linear, norm), *others = zip(_modules(self.linears), _modules(self.norms), strict=True)
        weight, shift = _with_fixed_norm(linear, norm)
        if near is None:
            # In single precision: these are places in the camera frame, which bfloat16 rounds to 4 mm.
            with torch.autocast(offsets.device.type, enabled=False):
                x = F.linear(offsets, weight[:, :3])
        else:
            # Padded, because tensor cores take channels in multiples of eight.
            x = F.linear(F.pad(offsets, (0, 5)), F.pad(weight[:, :3], (0, 5)))
        precision = x.dtype
        if features is not None:
            once = F.linear(features, weight[:, 3:])
            # In single precision: the gradient of a gather sums many terms; bfloat16 loses small ones, and its atomic
            # additions are slow.
            x = x + (once[:, None] if near is None else _rows(once.float(), near))
        groups = x.shape[:3]
        x = x.flatten(0, 2)
        x = norm(x.to(precision)) if shift is None else (x + shift).to(precision)
        for linear, norm in others:
            weight, shift = _with_fixed_norm(linear, norm)
            x = F.linear(F.relu(x), weight, shift)
            x = norm(x) if shift is None else x
        # ReLU and maximum commute; the maximum first is cheaper.
        return F.relu(x.unflatten(0, groups).max(dim=2)[0])


def _with_fixed_norm(linear: nn.Linear, norm: nn.BatchNorm1d) -> tuple[Tensor, Tensor | None]:
    """Weight and bias of a layer with its normalisation in it, if that is fixed; else its weight alone."""
    if norm.training or norm.running_mean is None or norm.running_var is None:
        return linear.weight, None
    scale = norm.weight * (norm.running_var + norm.eps).rsqrt()
    return linear.weight * scale[:, None], norm.bias - norm.running_mean * scale


def ball_query(centres: Tensor, points: Tensor, radius: float, count: int) -> Tensor:
    """The first points within each ball; the first one is repeated if there are fewer.

    Args:
        centres: (B, C, 3) [m], each one of the points.
        points: (B, N, 3) [m].
        radius: Radius of the balls [m].
        count: Number of points per ball.

    Returns:
        Indices (B, C, count).
    """
    # Summed per coordinate: torch.cdist starts a block of threads for each single distance.
    squared = torch.zeros((), device=points.device)
    for k in range(3):
        squared = squared + (centres[:, :, None, k] - points[:, None, :, k]).square()
    size = points.shape[1]
    place = torch.arange(size, dtype=torch.int32, device=points.device)
    first = torch.where(squared < radius**2, place, size).topk(min(count, size), largest=False, sorted=True)[0]
    return torch.where(first < size, first, first[..., :1]).long()


def _modules(stage: nn.Module) -> list[Any]:
    return list(stage.children())


def _rows(x: Tensor, index: Tensor) -> Tensor:
    """Rows (B, C, n, d) of x (B, N, d)."""
    flat = index.flatten(1).long()[..., None].expand(-1, -1, x.shape[-1])
    return x.gather(1, flat).view(*index.shape, x.shape[-1])


_TIME = 128


class PaperNet(nn.Module):
    """Score network over pose vectors; its last layers begin at zero.

    Args:
        dim: Length of the pose vector, 9 or 12.
        encoder: Encoder of the clouds; None: a new PointNet++.

    Attributes:
        X_tool_ee: Mean X_tool_ee of each category, (4, 4, 4), for the column that estimates the tool's pose.
        frequencies: Random Fourier features of the time, (64,).
    """

    X_tool_ee: Tensor
    frequencies: Tensor

    def __init__(self, dim: int = 12, encoder: PointNet2 | None = None) -> None:
        super().__init__()
        self.dim = dim
        self.encoder = encoder or PointNet2()
        # Rounded as the weight files will round them.
        self.register_buffer("frequencies", (30.0 * torch.randn(_TIME // 2)).half().float())
        self.register_buffer("X_tool_ee", torch.eye(4).repeat(len(Category), 1, 1))
        self.time = nn.Sequential(nn.Linear(_TIME, _TIME), nn.ReLU())
        self.pose = nn.Sequential(nn.Linear(dim, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU())
        size = self.encoder.size + 256 + _TIME
        self.heads = nn.ModuleList(
            [nn.Sequential(nn.Linear(size, 256), nn.ReLU(), nn.Linear(256, 3)) for _ in range(dim // 3)]
        )
        for head in self.heads:
            for parameter in list(head.children())[-1].parameters():
                nn.init.zeros_(parameter)

    def encode(self, points: Tensor) -> Tensor:
        """Feature (B, 1024) of clouds (B, N, 3) [m, camera frame], farthest-point samples first."""
        feature: Tensor = self.encoder(points)
        return feature

    def score(self, feature: Tensor, u: Tensor, t: Tensor) -> Tensor:
        """The score times sigma(t).

        Args:
            feature: Encoded clouds, (B, 1024).
            u: Pose vectors, (B, K, dim).
            t: Times, (B, K).

        Returns:
            (B, K, dim).
        """
        phase = 2 * torch.pi * t[..., None] * self.frequencies
        time = self.time(torch.cat([phase.sin(), phase.cos()], dim=-1).to(u.dtype))
        of_sample = torch.cat([time, self.pose(u)], dim=-1)
        size = self.encoder.size
        scores = []
        head: Any
        for head in self.heads:
            first, _, last = head
            # The cloud's part of the first layer is the same for all of its samples.
            of_cloud = F.linear(feature, first.weight[:, :size], first.bias)
            scores.append(last(F.relu(of_cloud[:, None] + F.linear(of_sample, first.weight[:, size:]))))
        return torch.cat(scores, dim=-1)

    def forward(self, points: Tensor, neighbours: Sequence[Tensor], u: Tensor, t: Tensor) -> Tensor:
        """Encoding and score in one call, for training; on a GPU the encoder runs in bfloat16.

        The score does not: at the lowest noise, 0.01, a rounding of 4 mm in a pose vector is noise of its own.

        Args:
            points: Clouds (B, N, 3) [m], camera frame.
            neighbours: `PointNet2.neighbours` of them.
            u: Noised pose vectors, (B, K, dim).
            t: Times, (B, K).

        Returns:
            The score times sigma(t), (B, K, dim).
        """
        with torch.autocast(points.device.type, torch.bfloat16, enabled=points.is_cuda):
            feature = self.encoder(points, neighbours)
        return self.score(feature.float(), u, t)
