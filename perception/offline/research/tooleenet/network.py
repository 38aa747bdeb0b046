"""The paper's noise-conditional score network on the PointNet++ feature, about 1.5 M parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.end_effectors import Category
from toolee_robot.perception.offline.research.tooleenet.pointnet2 import PointNet2

_TIME = 128


class PaperNet(nn.Module):
    """Score network over pose vectors.

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
