"""Cuts: the part of a tool that the mask of a synthetic cloud shows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from toolee_robot.perception.offline.synthetic_clouds.batch import CloudConfig, TorchRng
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import NOWHERE

_BORDER = (-0.4, 0.8)
"""How far beyond a focus an image ends, in radii."""


@dataclass(frozen=True)
class Cut:
    """The part that a mask shows: a sphere, or a circle in the image, less what is nearer to the tool's other end.

    Attributes:
        focus: Centre, (B, 3) [m], camera frame.
        radius: Radius, (B,) [m]; of a circle: at the focus's depth.
        other: The tool's other end, (B, 3) [m], camera frame.
        other_radius: Radius of the other end's sphere, (B,) [m]; spheres share the space in proportion to their radii.
        circle: Whether it is a circle in the image, (B,) bool.
    """

    focus: Tensor
    radius: Tensor
    other: Tensor
    other_radius: Tensor
    circle: Tensor

    @classmethod
    def drawn(
        cls,
        focus: Tensor,
        radius: Tensor,
        other: Tensor,
        other_radius: Tensor,
        config: CloudConfig,
        torch_rng: TorchRng,
    ) -> Cut:
        """Random cuts.

        Args:
            focus: Centre of each EE, (B, 3) [m], camera frame.
            radius: Radius of its category, (B,) [m].
            other: The tool's other end, (B, 3) [m], camera frame.
            other_radius: Radius of that end's category, (B,) [m].
            config: The distributions.
            torch_rng: Random numbers.

        Returns:
            The cuts.
        """
        B = len(focus)
        differs = torch_rng.uniform(B) < config.other_cut_share
        factor = torch.where(differs, torch_rng.uniform(B, *config.other_cut), 1.0)
        circle = differs & (torch_rng.uniform(B) < config.circle_share)
        return cls(focus, radius * factor, other, other_radius * factor, circle)

    def holds(self, points: Tensor) -> Tensor:
        """Which points (B, N, 3) [m], camera frame, the mask shows: (B, N) bool."""
        ratio = (self.radius / self.other_radius)[:, None]
        own, other = _distance(points, self.focus), _distance(points, self.other)
        in_sphere = (own < self.radius[:, None]) & (own <= ratio * other)
        own, other = self._across(points, self.focus), self._across(points, self.other)
        # The far-away stand-in of a missing other end may still lie in the line of sight.
        alone = (self.other.norm(dim=-1) > NOWHERE / 2)[:, None]
        in_circle = (own < self.radius[:, None]) & (alone | (own <= other))
        return torch.where(self.circle[:, None], in_circle, in_sphere)

    def _across(self, points: Tensor, centre: Tensor) -> Tensor:
        """Distance [m] in the image from a centre (B, 3), at the focus's depth: (B, N)."""
        return self.focus[:, None, 2] * (_projected(points) - _projected(centre)[:, None]).norm(dim=-1)


@dataclass(frozen=True)
class Border:
    """The border of an image, along u or v.

    A ray (x, y, 1) is inside where its product with the normal is under the limit.

    Attributes:
        normal: (B, 2).
        limit: (B,); infinite where the image is wide enough.
    """

    normal: Tensor
    limit: Tensor

    @classmethod
    def drawn(cls, focus: Tensor, radius: Tensor, share: float, torch_rng: TorchRng) -> Border:
        """Random borders, never such that the image lacks its own middle.

        Args:
            focus: Centre of each EE, (B, 3) [m], camera frame.
            radius: Radius of its sphere, (B,) [m].
            share: Share of the clouds with a border near the focus.
            torch_rng: Random numbers.

        Returns:
            The borders.
        """
        B = len(focus)
        ray = _projected(focus)
        across = torch.nn.functional.one_hot(torch_rng.integers(0, 2, B), 2).to(ray.dtype)
        normal = across * torch.where(ray < 0, -1.0, 1.0)
        centre = (normal * ray).sum(1)
        limit = (centre + torch_rng.uniform(B, *_BORDER) * radius / focus[:, 2].clamp_min(0.05)).clamp_min(0.05)
        return cls(normal, torch.where(torch_rng.uniform(B) < share, limit, torch.inf))

    def shows(self, rays: Tensor) -> Tensor:
        """Which rays (B, H, W, 3) with z = 1 are inside of the image: (B, H, W) bool."""
        return (rays[..., :2] * self.normal[:, None, None]).sum(-1) < self.limit[:, None, None]


@dataclass(frozen=True)
class Target:
    """What each mask is claimed to show, and what it shows.

    Attributes:
        focus: Centre of the claimed sphere, (B, 3) [m], camera frame.
        radius: Its radius, (B,) [m].
        cut: What the mask really shows.
        border: Where the image ends.
        claimed: The claimed category, (B,).
        positive: Whether the claim is right, (B,) bool.
        admissible: If not, whether it is a sensible negative, (B,) bool.
        on_hand: Whether the mask is on the hand instead of the tool, (B,) bool.
    """

    focus: Tensor
    radius: Tensor
    cut: Cut
    border: Border
    claimed: Tensor
    positive: Tensor
    admissible: Tensor
    on_hand: Tensor


def _projected(points: Tensor) -> Tensor:
    """Where the rays to points (..., 3), camera frame, meet z = 1: (..., 2)."""
    return points[..., :2] / points[..., 2:].clamp_min(0.05)


def _distance(points: Tensor, centre: Tensor) -> Tensor:
    return (points - centre[:, None]).norm(dim=-1)
