"""Variants for the ablations: another encoder, un-centred clouds, other poolings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from toolee_robot.frames import Array, transform
from toolee_robot.perception.offline.pose.recipe import DefaultRecipe
from toolee_robot.perception.offline.research.tooleenet.pointnet2 import PointNet2
from toolee_robot.perception.offline.research.tooleenet.pooling import mean_pose
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch
from toolee_robot.perception.offline.synthetic_clouds.generator import CloudGenerator
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import Float32, SurfaceSamples
from toolee_robot.perception.pose.canonical import POINTS
from toolee_robot.perception.pose.network import NetworkConfig, PoseNet, Seen
from toolee_robot.perception.pose.pooling import align, pool
from toolee_robot.symmetry import SymmetryGroup

_FAR = 15.0
"""Factor by which un-centred coordinates are larger than centred ones."""


class PointNetPose(PoseNet):
    """The pose network's heads and tokens on the paper's PointNet++.

    Args:
        config: Architecture of the heads.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        for name in ("ee", "blocks", "norm"):
            delattr(self, name)
        d = config.width
        self.points = PointNet2()
        self.join = nn.Sequential(nn.Linear(self.points.size + 4 * d, 2 * d), nn.SiLU(), nn.Linear(2 * d, 2 * d))

    def encode(self, seen: Seen, mirror: bool = False) -> Tensor:
        """See `PoseNet`; all points are in farthest-point order."""
        seen = seen.with_mirror() if mirror else seen
        tokens = [self.category(seen.category), self.direction(seen.direction), self.context(seen.context)]
        rest = self.rest_tokens(seen).mean(1)
        feature: Tensor = self.join(torch.cat([self.points(seen.points), *tokens, rest], dim=-1))
        return feature


@dataclass(frozen=True)
class WithPointNet(DefaultRecipe):
    """`DefaultRecipe` with `PointNetPose`."""

    def clouds(self, samples: SurfaceSamples, hands: Float32, device: torch.device, seed: int) -> CloudGenerator:
        """See `TrainingRecipe`."""
        return CloudGenerator(samples, hands, device, seed, replace(self.clouds_config, ordered=POINTS, guessed=False))

    def network(self, samples: SurfaceSamples) -> PoseNet:  # noqa: ARG002 - as the protocol
        """See `TrainingRecipe`."""
        return PointNetPose(self.config)


class UncentredGenerator(CloudGenerator):
    """Clouds in the camera frame, neither centred nor rotated. The pose's position stays relative to the centre."""

    def generate(self, n: int) -> CloudBatch:
        """See `CloudGenerator`."""
        batch = super().generate(n)
        back = batch.R_canonical.mT
        direction = torch.cat([(back @ batch.direction[:, :3, None])[..., 0], batch.direction[:, 3:]], dim=-1)
        return replace(
            batch,
            points=torch.einsum("bij,bnj->bni", back, batch.points) + batch.centre[:, None],
            rest=torch.einsum("bij,bnj->bni", back, batch.rest) + batch.centre[:, None],
            R=back @ batch.R,
            p=torch.einsum("bij,bj->bi", back, batch.p),
            direction=direction,
            R_canonical=torch.eye(3, device=back.device).expand_as(back).contiguous(),
        )


class _Scale(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return x / _FAR


@dataclass(frozen=True)
class Uncentred(DefaultRecipe):
    """`DefaultRecipe` on the clouds of `UncentredGenerator`."""

    def clouds(self, samples: SurfaceSamples, hands: Float32, device: torch.device, seed: int) -> CloudGenerator:
        """See `TrainingRecipe`."""
        return UncentredGenerator(samples, hands, device, seed, self.clouds_config)

    def network(self, samples: SurfaceSamples) -> PoseNet:
        """See `TrainingRecipe`."""
        net = super().network(samples)
        for patches in (net.ee, net.rest):
            patches.place = nn.Sequential(_Scale(), *patches.place)
        return net


def group_mean(Xs: Array, group: SymmetryGroup) -> Array:
    """Mean of poses modulo a symmetry group.

    Args:
        Xs: Poses, (K, 4, 4).
        group: The group.

    Returns:
        The mean, (4, 4).
    """
    return mean_pose(Xs, group)


def robust_mean(Xs: Array, group: SymmetryGroup) -> Array:
    """Mean of all poses with Cauchy weights, modulo a symmetry group, without modes.

    Args:
        Xs: Poses, (K, 4, 4).
        group: The group.

    Returns:
        The mean, (4, 4).
    """
    X = mean_pose(Xs, group)
    for _ in range(10):
        R = align(Xs[:, :3, :3], X[:3, :3], group)
        w = Rotation.from_matrix(R @ X[:3, :3].T).as_rotvec()
        dp = Xs[:, :3, 3] - X[:3, 3]
        a, b = (w**2).sum(1), (dp**2).sum(1)
        weight = 1 / (1 + (a / (np.median(a) + 1e-6) + b / (np.median(b) + 1e-9)) / 4)
        weight /= weight.sum()
        X = transform(Rotation.from_rotvec(weight @ w).as_matrix() @ X[:3, :3], X[:3, 3] + weight @ dp)
    return X


def clustered(Xs: Array, group: SymmetryGroup) -> Array:
    """The default pooling: the robust mean of the heaviest mode.

    Args:
        Xs: Poses, (K, 4, 4).
        group: The group.

    Returns:
        The mean, (4, 4).
    """
    return pool(Xs, group).X


POOLINGS = {
    "mean (the paper's)": lambda Xs, group: mean_pose(Xs),  # noqa: ARG005 - knows no group
    "mean modulo the group": group_mean,
    "robust": robust_mean,
    "cluster": clustered,
}
"""Poolings by name: candidate poses (K, 4, 4) and group to a pose, 4x4."""
