"""What training clouds are made of, and a batch of them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from toolee_robot.perception.pose.canonical import PATCHES, POINTS, CanonicalCloud


@dataclass(frozen=True)
class CloudConfig:
    """What is varied; shares are probabilities.

    distance: of the EE [m]; near_share of them not beyond `near` [m]. focal [px], or, in a kinect_share, a Kinect's.
    field: half the field of view to the right and down, as tangents. upright: tools stand, held in the nominal grasp up
    to 5 cm along the handle, before a camera that is pitched from -45 to 30 deg and never rolled. sensor_level: None:
    random sensors. radius [m] of the crop about the EE, None: the category's own. other_cut_share: how often the mask
    is cut at a radius that many times as large (`other_cut`), as a detector's or another's may be, and circle_share:
    how often that is a circle in the image, as the paper's; circle: if not None, every mask is one of this radius [px].
    border_share: how often the image ends near the EE. rest: whether the rest of the tool is seen, too;
    rest_error_share, rest_chunk_share: how often its mask is imperfect, a piece of it missing; rest_gap_share: how
    often it begins up to rest_gap [m] beyond the cut; wrong_rest_share: how often it is another tool's. guessed:
    whether the mask's pixels without a depth are there, too, at a completed one. points, of which the first `ordered`
    are farthest-point samples: what the network takes."""

    distance: tuple[float, float] = (0.35, 1.1)
    near_share: float = 0.25
    near: float = 0.75
    field: tuple[float, float] = (0.5, 0.42)
    upright: bool = False
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
    other_cut_share: float = 0.5
    other_cut: tuple[float, float] = (0.5, 1.65)
    circle_share: float = 0.35
    circle: float | None = None
    border_share: float = 0.08
    rest: bool = True
    rest_error_share: float = 0.7
    rest_chunk_share: float = 0.3
    rest_gap_share: float = 0.5
    rest_gap: float = 0.02
    wrong_rest_share: float = 0.02
    guessed: bool = True
    points: int = POINTS
    ordered: int = PATCHES

    @classmethod
    def paper(cls) -> CloudConfig:
        """The paper's protocol, as `dataset.paper` renders it: exact depth and masks, an upright tool in one grasp, the
        EE a circle in the image. No negatives: the paper's estimator has no use for them."""
        return cls(
            distance=(0.42, 0.98),
            near_share=0.0,
            focal=(480.0, 480.0),
            kinect_share=0.0,
            field=(0.875, 0.4375),
            upright=True,
            hand_share=1.0,
            occluder_share=0.0,
            mask_error_share=0.0,
            chunk_share=0.0,
            negative_share=0.0,
            sensor_level=0.0,
            circle=30.0,
            border_share=0.0,
            rest_error_share=0.0,
            rest_chunk_share=0.0,
            rest_gap_share=0.0,
            wrong_rest_share=0.0,
        )


PROTOCOLS = {"hard": CloudConfig, "paper": CloudConfig.paper}
"""Clouds as the data set's configurations of these names have them."""


@dataclass(frozen=True)
class CloudBatch:
    """Canonical clouds and their truth, all tensors with the batch first.

    points (B, 512, 3), completed (B, 512), centre (B, 3), R_canonical (B, 3, 3), rest (B, 256, 3), rest_known (B,): see
    `canonical.CanonicalCloud`. R (B, 3, 3), p (B, 3):
    the EE's pose in the canonical frame. direction (B, 5): the token, given for all. spin_pixels (B,): pixels in the
    mask that tell the spin. category, item (B,); positive (B,): whether it is that category's EE at all;
    visible (B,): native points; occlusion (B,) in [0, 1]; distance (B,) [m].
    """

    points: Tensor
    completed: Tensor
    centre: Tensor
    R_canonical: Tensor
    rest: Tensor
    rest_known: Tensor
    R: Tensor
    p: Tensor
    direction: Tensor
    spin_pixels: Tensor
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
        seen = self.points, self.completed, self.centre, self.R_canonical
        return CanonicalCloud(*seen, self.visible, self.rest, self.rest_known)

    @classmethod
    def of(cls, cloud: CanonicalCloud, R: Tensor, p: Tensor, **about: Tensor) -> CloudBatch:
        """Of clouds with their EEs' poses R (B, 3, 3), p (B, 3) [m], camera frame; about: the fields that neither
        has."""
        return cls(
            points=cloud.points,
            completed=cloud.completed,
            centre=cloud.centre,
            R_canonical=cloud.R,
            rest=cloud.rest,
            rest_known=cloud.rest_known,
            R=cloud.R @ R,
            p=torch.einsum("bij,bj->bi", cloud.R, p - cloud.centre),
            **about,
        )

    def select(self, index: Tensor) -> CloudBatch:
        """The rows of an index or mask."""
        return CloudBatch(*(getattr(self, f.name)[index] for f in fields(self)))

    @staticmethod
    def cat(batches: list[CloudBatch]) -> CloudBatch:
        return CloudBatch(*(torch.cat([getattr(b, f.name) for b in batches]) for f in fields(CloudBatch)))
