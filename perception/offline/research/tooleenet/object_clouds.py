"""Clouds of whole tools, for the column that estimates the tool's pose and derives the EE's from a prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse
from toolee_robot.perception.offline.research.tooleenet.estimator import OBJECT_RADIUS
from toolee_robot.perception.offline.research.tooleenet.pooling import mean_pose
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch, CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.cuts import Border, Cut, Target
from toolee_robot.perception.offline.synthetic_clouds.generator import WHOLE_TOOL, CloudGenerator
from toolee_robot.perception.offline.synthetic_clouds.scene import Placement, rigid_inverse
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import Float32, SurfaceSamples


class ObjectCloudGenerator(CloudGenerator):
    """The same scenes, with the whole tool under the mask and the tool's pose as the truth.

    Of a tool with two alike ends only the first, the working end, is asked for, because the tool's pose does not show
    which of them is meant.

    Args:
        samples: Surface samples of tools.
        hands: Surface samples of hands, (H, 6144, 3) [m].
        device: torch device.
        seed: Seed of all random numbers.
        config: Distributions of the clouds.
    """

    reach = WHOLE_TOOL

    def __init__(
        self, samples: SurfaceSamples, hands: Float32, device: torch.device | str, seed: int, config: CloudConfig
    ) -> None:
        super().__init__(samples, hands, device, seed, config)
        self._weights = self._weights * first_ends(samples)
        self._weights /= self._weights.sum()
        surface = np.concatenate([samples.ee_points, samples.rest], axis=1)
        self._middle = torch.as_tensor((surface.min(1) + surface.max(1)) / 2, device=self._device)

    def _target(self, placed: Placement) -> Target:
        no = torch.zeros_like(placed.has_hand)
        focus = torch.einsum("bij,bj->bi", placed.R, self._middle[placed.item]) + placed.p
        radius = torch.full_like(placed.distance, OBJECT_RADIUS)
        border = Border.drawn(focus, radius, self.config.border_share, self._torch_rng)
        return Target(focus, radius, Cut.sphere(focus, radius), border, self._category[placed.item], ~no, no, no)

    def _truth(self, placed: Placement) -> tuple[Tensor, Tensor]:
        p_ee_tool = placed.X_ee_tool[:, :3, 3]
        p = torch.einsum("bij,bj->bi", placed.R, p_ee_tool) + placed.p
        return placed.R @ placed.X_ee_tool[:, :3, :3], p


def first_ends(samples: SurfaceSamples) -> Array:
    """(I,) 1 for the first EE of its category on its tool, else 0."""
    seen: set[str] = set()
    return np.array([float(name not in seen and not seen.add(name)) for name in samples.names])  # type: ignore[func-returns-value]


def category_priors(samples: SurfaceSamples) -> Array:
    """Mean X_tool_ee of each category over the sampled tools, modulo its group.

    Returns:
        (4, 4, 4); the identity where there are none.
    """
    priors = np.tile(np.eye(4), (len(Category), 1, 1))
    first = first_ends(samples) > 0
    for i, category in enumerate(Category):
        rows = first & (samples.category == i)
        if rows.any():
            priors[i] = mean_pose(inverse(samples.X_ee_tool[rows].astype(np.float64)), category.symmetry)
    return priors


def with_ee_truth(batch: CloudBatch, samples: SurfaceSamples) -> CloudBatch:
    """Replace the tool's pose, as the truth of whole-tool clouds, by the EE's.

    Args:
        batch: The clouds.
        samples: Surface samples of the tools, which hold the pose of the tool in the EE.

    Returns:
        The clouds with the other truth.
    """
    X = rigid_inverse(torch.as_tensor(samples.X_ee_tool, device=batch.R.device)[batch.item])
    p = batch.p + torch.einsum("bij,bj->bi", batch.R, X[:, :3, 3])
    return replace(batch, R=batch.R @ X[:, :3, :3], p=p)
