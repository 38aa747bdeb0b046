"""Which part of a tool a training cloud's mask shows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from toolee_robot.perception.pose.synthetic_clouds.batch import CloudConfig
from toolee_robot.perception.pose.synthetic_clouds.surface_samples import NOWHERE
from toolee_robot.perception.pose.synthetic_clouds.torch_rng import TorchRng

_BORDER = (-0.4, 0.8)
"""How far beyond a focus an image ends, in radii."""


@dataclass(frozen=True)
class Cut:
    """A sphere about focus (B, 3) of radius (B,); or, where circle (B,), what a circle in the image shows that has this
    radius at the focus's depth. Less what is nearer to the tool's other end, other (B, 3): for spheres in proportion to
    the radii, theirs other_radius (B,). All [m], camera frame."""

    focus: Tensor
    radius: Tensor
    other: Tensor
    other_radius: Tensor
    circle: Tensor

    @classmethod
    def sphere(cls, focus: Tensor, radius: Tensor) -> Cut:
        """Of tools with one end."""
        return cls(focus, radius, torch.full_like(focus, NOWHERE), radius, torch.zeros_like(radius, dtype=torch.bool))

    @classmethod
    def drawn(
        cls,
        focus: Tensor,
        radius: Tensor,
        other: Tensor,
        other_radius: Tensor,
        config: CloudConfig,
        f: Tensor,
        torch_rng: TorchRng,
    ) -> Cut:
        """As `config` has it; radius (B,) [m]: the category's own. f (B,) [px] of the camera."""
        B = len(focus)
        if config.circle is not None:
            radius = config.circle / f * focus[:, 2]
            return cls(focus, radius, other, radius, torch.ones_like(radius, dtype=torch.bool))
        differs = torch_rng.uniform(B) < config.other_cut_share
        factor = torch.where(differs, torch_rng.uniform(B, *config.other_cut), 1.0)
        circle = differs & (torch_rng.uniform(B) < config.circle_share)
        return cls(focus, radius * factor, other, other_radius * factor, circle)

    def holds(self, points: Tensor) -> Tensor:
        """Whether the mask shows them: (B, N) of points (B, N, 3)."""
        ratio = (self.radius / self.other_radius)[:, None]
        own, other = _distance(points, self.focus), _distance(points, self.other)
        in_sphere = (own < self.radius[:, None]) & (own <= ratio * other)
        own, other = self._across(points, self.focus), self._across(points, self.other)
        # What is nowhere may still lie in the line of sight.
        alone = (self.other.norm(dim=-1) > NOWHERE / 2)[:, None]
        in_circle = (own < self.radius[:, None]) & (alone | (own <= other))
        return torch.where(self.circle[:, None], in_circle, in_sphere)

    def _across(self, points: Tensor, centre: Tensor) -> Tensor:
        """(B, N) distance [m] in the image from a centre (B, 3), at the focus's depth."""
        return self.focus[:, None, 2] * (_projected(points) - _projected(centre)[:, None]).norm(dim=-1)


@dataclass(frozen=True)
class Border:
    """Where an image ends: at rays (x, y, 1) whose product with normal (B, 2), along u or v, is limit (B,), infinite
    where the image is wide enough."""

    normal: Tensor
    limit: Tensor

    @classmethod
    def drawn(cls, focus: Tensor, radius: Tensor, share: float, torch_rng: TorchRng) -> Border:
        """In a `share` of the clouds near the focus (B, 3) [m, camera frame] of a sphere of radius (B,) [m], and never
        such that the image would not hold its own middle."""
        B = len(focus)
        ray = _projected(focus)
        across = torch.nn.functional.one_hot(torch_rng.integers(0, 2, B), 2).to(ray.dtype)
        normal = across * torch.where(ray < 0, -1.0, 1.0)
        centre = (normal * ray).sum(1)
        limit = (centre + torch_rng.uniform(B, *_BORDER) * radius / focus[:, 2].clamp_min(0.05)).clamp_min(0.05)
        return cls(normal, torch.where(torch_rng.uniform(B) < share, limit, torch.inf))

    def shows(self, rays: Tensor) -> Tensor:
        """Whether the image holds rays (B, H, W, 3), z = 1: (B, H, W)."""
        return (rays[..., :2] * self.normal[:, None, None]).sum(-1) < self.limit[:, None, None]


@dataclass(frozen=True)
class Target:
    """What a mask is said to show. focus (B, 3) [m, camera frame] and radius (B,) [m] of its sphere; cut: what it
    really shows; border: where the image ends; claimed (B,): the category; positive (B,): rightly so; admissible (B,):
    whether, if not, it is a negative that makes sense; on_hand (B,): the mask lies on the hand instead of on the tool.
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
    """(..., 2) of points (..., 3), camera frame: where their rays are at z = 1."""
    return points[..., :2] / points[..., 2:].clamp_min(0.05)


def _distance(points: Tensor, centre: Tensor) -> Tensor:
    return (points - centre[:, None]).norm(dim=-1)
