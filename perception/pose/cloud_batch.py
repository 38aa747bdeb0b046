"""What training clouds are made of, and a batch of them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from toolee_robot.perception.pose.canonical import PATCHES, POINTS, CanonicalCloud


@dataclass(frozen=True)
class CloudConfig:
    """What is varied. distance [m], focal [px]; shares are probabilities. sensor_level: None for random sensors.
    radius [m] of the crop about the EE, None: the category's own; other_radius_share: how often the mask is cut at half
    to one and a half times that, as another's masks may be (the paper's circle in pixels). rest: whether the rest of
    the tool is seen, too; rest_error_share, rest_chunk_share: how often its mask is imperfect, a piece of it missing;
    wrong_rest_share: how often it is another tool's. guessed: whether the mask's pixels without a depth are there, too,
    at a guessed one. points, of which the first `ordered` are
    farthest-point samples: what the network takes."""

    distance: tuple[float, float] = (0.35, 1.1)
    near_share: float = 0.65
    near: float = 0.75
    focal: tuple[float, float] = (350.0, 700.0)
    kinect_share: float = 0.5
    hand_share: float = 0.85
    occluder_share: float = 0.4
    mask_error_share: float = 0.8
    chunk_share: float = 0.15
    cleaned_share: float = 0.8
    negative_share: float = 0.12
    max_occlusion: float = 0.7
    sensor_level: float | None = None
    radius: float | None = None
    other_radius_share: float = 0.35
    rest: bool = True
    rest_error_share: float = 0.7
    rest_chunk_share: float = 0.3
    wrong_rest_share: float = 0.02
    guessed: bool = True
    points: int = POINTS
    ordered: int = PATCHES


@dataclass(frozen=True)
class CloudBatch:
    """Canonical clouds and their truth, all tensors with the batch first.

    points (B, 512, 3), guessed (B, 512), centre (B, 3), R_canonical (B, 3, 3), rest (B, 256, 3), rest_known (B,): see
    `canonical.CanonicalCloud`. R (B, 3, 3), p (B, 3):
    the EE's pose in the canonical frame. direction (B, 5): the token, given for all. tells_spin (B,): pixels in the
    mask that tell the spin. category, item (B,); positive (B,): whether it is that category's EE at all;
    visible (B,): native points; occlusion (B,) in [0, 1]; distance (B,) [m].
    """

    points: Tensor
    guessed: Tensor
    centre: Tensor
    R_canonical: Tensor
    rest: Tensor
    rest_known: Tensor
    R: Tensor
    p: Tensor
    direction: Tensor
    tells_spin: Tensor
    category: Tensor
    item: Tensor
    positive: Tensor
    visible: Tensor
    occlusion: Tensor
    distance: Tensor

    def __len__(self) -> int:
        return len(self.points)

    @property
    def cloud(self) -> CanonicalCloud:
        """What an estimator gets of it."""
        seen = self.points, self.guessed, self.centre, self.R_canonical
        return CanonicalCloud(*seen, self.visible, self.rest, self.rest_known)

    def select(self, index: Tensor) -> CloudBatch:
        """The rows of an index or mask."""
        return CloudBatch(*(getattr(self, f.name)[index] for f in fields(self)))

    @staticmethod
    def cat(batches: list[CloudBatch]) -> CloudBatch:
        return CloudBatch(*(torch.cat([getattr(b, f.name) for b in batches]) for f in fields(CloudBatch)))
