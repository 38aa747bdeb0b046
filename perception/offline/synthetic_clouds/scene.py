"""Around the tool of a synthetic cloud: placement, cut of the mask, hand, occluders, background, direction tokens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from toolee_robot.perception.offline.synthetic_clouds import point_splatting
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudConfig, TorchRng
from toolee_robot.perception.offline.synthetic_clouds.point_splatting import ZBuffer
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


DIRECTION_SIGMA = 0.1
"""Standard deviation [rad] of most directions to the rest of a tool."""


@dataclass(frozen=True)
class Placement:
    """Held tools in front of the camera, a batch of B; all in the camera frame.

    Attributes:
        item: Row of the surface samples, (B,).
        R: Orientation of the EE, (B, 3, 3).
        p: Position of the EE, (B, 3) [m].
        ee: Its surface points, (B, N, 3) [m].
        normals: Their normals, (B, N, 3).
        rest: The tool's other surface points, (B, M, 3) [m].
        hand: The hand's surface points, (B, H, 3) [m]; behind the camera where there is none.
        p_hand: Position of the hand, (B, 3) [m].
        has_hand: (B,) bool.
        X_ee_tool: (B, 4, 4).
        X_tool_hand: (B, 4, 4).
        f_native: Focal length of the camera, (B,) [px].
        distance: Distance of the EE, (B,) [m].
    """

    item: Tensor
    R: Tensor
    p: Tensor
    ee: Tensor
    normals: Tensor
    rest: Tensor
    hand: Tensor
    p_hand: Tensor
    has_hand: Tensor
    X_ee_tool: Tensor
    X_tool_hand: Tensor
    f_native: Tensor
    distance: Tensor

    @property
    def height(self) -> Tensor:
        """Position of each point of `rest` along the handle from the grip's centre, (B, M) [m]."""
        X_tool_ee = rigid_inverse(self.X_ee_tool)
        axis = torch.einsum("bi,bji->bj", X_tool_ee[:, 2, :3], self.R)
        return torch.einsum("bj,bnj->bn", axis, self.rest - self.p[:, None]) + X_tool_ee[:, 2, 3, None]


def draw_occluders(
    buffer: ZBuffer, focus: Tensor, radius: Tensor, rays: Tensor, share: float, torch_rng: TorchRng
) -> None:
    """Draw ellipses between the camera and the EE.

    Args:
        buffer: The z-buffer.
        focus: Centre of each EE, (B, 3) [m], camera frame.
        radius: Its radius, (B,) [m].
        rays: Directions of the pixels with z = 1, (B, H, W, 3).
        share: Share of the clouds with an occluder.
        torch_rng: Random numbers.
    """
    B = len(focus)
    z = focus[:, 2]
    around = rays[..., :2] * z[:, None, None, None] - focus[:, None, None, :2]
    offset = torch_rng.normal(B, 2) * 0.8 * radius[:, None]
    d = around - offset[:, None, None]
    angle = torch_rng.uniform(B, 0, 2 * torch.pi)[:, None, None]
    a = d[..., 0] * angle.cos() + d[..., 1] * angle.sin()
    b = d[..., 1] * angle.cos() - d[..., 0] * angle.sin()
    size_a, size_b = torch_rng.uniform(B, 0.006, 0.06)[:, None, None], torch_rng.uniform(B, 0.006, 0.03)[:, None, None]
    present = (torch_rng.uniform(B) < share)[:, None, None]
    inside = present & ((a / size_a) ** 2 + (b / size_b) ** 2 < 1)
    slope = torch_rng.normal(B, 2) * 0.3
    depth = (z - torch_rng.uniform(B, 0.02, 0.25))[:, None, None] + (d * slope[:, None, None]).sum(-1)
    buffer.fill(depth, inside, point_splatting.OCCLUDER)


def draw_backgrounds(buffer: ZBuffer, focus: Tensor, rays: Tensor, torch_rng: TorchRng) -> None:
    """Draw a tilted plane behind the tool, near or far, or none.

    Args:
        buffer: The z-buffer.
        focus: Centre of each EE, (B, 3) [m], camera frame.
        rays: Directions of the pixels with z = 1, (B, H, W, 3).
        torch_rng: Random numbers.
    """
    B = len(focus)
    gap = torch.exp(torch_rng.uniform(B, float(np.log(0.05)), float(np.log(2.0))))
    around = rays[..., :2] * focus[:, 2, None, None, None] - focus[:, None, None, :2]
    slope = torch_rng.normal(B, 2) * 0.5
    depth = (focus[:, 2] + gap)[:, None, None] + (around * slope[:, None, None]).sum(-1)
    present = (torch_rng.uniform(B) < 0.85)[:, None, None]
    buffer.fill(depth, present.expand_as(depth), point_splatting.BACKGROUND)


def directions(placed: Placement, centre: Tensor, R_canonical: Tensor, torch_rng: TorchRng) -> Tensor:
    """Noisy direction tokens.

    From the cloud's centre to the mean of a visible part of the rest of the tool, or to the hand.

    Args:
        placed: The tools.
        centre: Centres of the clouds, (B, 3) [m], camera frame.
        R_canonical: (B, 3, 3).
        torch_rng: Random numbers.

    Returns:
        Tokens (B, 5), canonical frame.
    """
    B, height = len(centre), placed.height
    low, high = height.min(1).values, height.max(1).values
    length = high - low
    a = low + length * torch_rng.uniform(B, 0.0, 0.5) * (torch_rng.uniform(B) < 0.6)
    b = high - length * torch_rng.uniform(B, 0.0, 0.4) * (torch_rng.uniform(B) < 0.6)
    kept = (height >= a[:, None]) & (height <= b[:, None])
    under_hand = (height - placed.X_tool_hand[:, 2, 3, None]).abs() < 0.045
    hides = placed.has_hand & (torch_rng.uniform(B) < 0.85)
    kept &= ~(under_hand & hides[:, None])
    mean = (placed.rest * kept[..., None]).sum(1) / kept.sum(1, keepdim=True).clamp_min(1)
    by_hand = (torch_rng.uniform(B) < 0.3) | (kept.sum(1) < 20)
    goal = torch.where(by_hand[:, None], placed.p_hand + 0.01 * torch_rng.normal(B, 3), mean)
    sigma = torch.where(torch_rng.uniform(B) < 0.1, 0.35, DIRECTION_SIGMA)[:, None]
    return direction_token(goal, centre, R_canonical, by_hand, sigma, torch_rng)


def direction_token(
    goal: Tensor, centre: Tensor, R: Tensor, by_hand: Tensor, sigma: Tensor, torch_rng: TorchRng
) -> Tensor:
    """Direction tokens with noise.

    Args:
        goal: Where they point, (B, 3) [m], camera frame.
        centre: Where they start, (B, 3) [m], camera frame.
        R: Canonical rotations, (B, 3, 3).
        by_hand: Whether the goal is the hand, (B,) bool.
        sigma: Standard deviation [rad].
        torch_rng: Random numbers.

    Returns:
        Tokens (B, 5), canonical frame.
    """
    d = torch.nn.functional.normalize(goal - centre, dim=-1)
    d = torch.nn.functional.normalize(d + sigma * torch_rng.normal(len(d), 3), dim=-1)
    d = torch.einsum("bij,bj->bi", R, d)
    return torch.cat([d, torch.ones_like(d[:, :1]), by_hand.float()[:, None]], dim=-1)


def rigid_inverse(X: Tensor) -> Tensor:
    """Inverse of rigid transforms (B, 4, 4)."""
    Y = X.clone()
    Y[:, :3, :3] = X[:, :3, :3].mT
    Y[:, :3, 3] = -torch.einsum("bji,bj->bi", X[:, :3, :3], X[:, :3, 3])
    return Y
