"""Training of the pose network: targets, exact augmentation and the loss."""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch
from toolee_robot.perception.pose.estimator import context_input
from toolee_robot.perception.pose.network import Seen
from toolee_robot.perception.pose.processes import Process
from toolee_robot.perception.pose.representation import AMBIGUOUS, AXIS_X, AXIS_Z, DIM, POSITION, decode, encode
from toolee_robot.symmetry import SymmetryKind

_FREE = [i for i, c in enumerate(CATEGORIES) if c.symmetry.kind is SymmetryKind.CINF]
CUED = [i for i in _FREE if CATEGORIES[i].spec.spin_cues]
"""Indices of the categories whose free spin some views show."""
UNCUED = [i for i in _FREE if not CATEGORIES[i].spec.spin_cues]
"""Indices of the categories whose free spin no view shows."""
TWOFOLD = [i for i, c in enumerate(CATEGORIES) if c.symmetry.kind is SymmetryKind.C2]
"""Indices of the categories with a twofold symmetry (half a turn about x)."""
SPIN_PIXELS = 25
"""So many pixels of symmetry-breaking parts (a hammer's handle, its claw) show the spin."""


def augment(batch: CloudBatch, generator: torch.Generator) -> CloudBatch:
    """Augment clouds exactly: a random roll of the camera about the ray, and in half of the cases a mirror image.

    Mirrored by M = diag(-1, 1, 1), a tool whose own mirror plane is D = diag(1, -1, 1) (hammers, claws, screwdrivers)
    has the pose M R D. Wrenches mirror in z instead, which is the same pose modulo their C2 group.

    Args:
        batch: The clouds.
        generator: Random numbers, on the clouds' device.

    Returns:
        The clouds with their poses and directions.
    """
    B, device = len(batch), batch.points.device
    a = 2 * torch.pi * torch.rand(B, device=device, generator=generator)
    flip = torch.where(torch.rand(B, device=device, generator=generator) < 0.5, -1.0, 1.0)
    c, s, o, i = a.cos(), a.sin(), torch.zeros_like(a), torch.ones_like(a)
    # Roll after mirroring x.
    G = torch.stack([c * flip, -s, o, s * flip, c, o, o, o, i], -1).view(B, 3, 3)
    D = torch.stack([i, flip, i], -1)
    direction = torch.cat([torch.einsum("bij,bj->bi", G, batch.direction[:, :3]), batch.direction[:, 3:]], -1)
    return replace(
        batch,
        points=torch.einsum("bij,bnj->bni", G, batch.points),
        rest=torch.einsum("bij,bnj->bni", G, batch.rest),
        R=G @ batch.R * D[:, None],
        p=torch.einsum("bij,bj->bi", G, batch.p),
        direction=direction,
    )


def without_rest(batch: CloudBatch, share: float, direction_share: float, generator: torch.Generator) -> CloudBatch:
    """Drop the rest of the tool at random and, where it is not known, the direction to it.

    Args:
        batch: The clouds.
        share: Share of the clouds that lose the rest.
        direction_share: Share of the clouds without a rest that lose the direction.
        generator: Random numbers, on the clouds' device.

    Returns:
        The clouds.
    """
    device = batch.points.device
    known = batch.rest_known & (torch.rand(len(batch), device=device, generator=generator) >= share)
    directed = known | (torch.rand(len(batch), device=device, generator=generator) >= direction_share)
    rest = torch.where(known[:, None, None], batch.rest, 0.0)
    return replace(batch, rest=rest, rest_known=known, direction=batch.direction * directed[:, None])


def canonical_rotation(R: Tensor, category: Tensor) -> Tensor:
    """Choose one member of each orbit as the regression target: otherwise one cloud would have several right answers.

    Wrenches (C2 about x): z toward the camera. Screwdrivers (free spin, never observable): x toward the camera.

    Args:
        R: Rotations (B, 3, 3), canonical frame.
        category: Index of each category, (B,).

    Returns:
        Rotations (B, 3, 3).
    """
    flip = _among(category, TWOFOLD) & (R[:, 2, 2] > 0)
    R = torch.where(flip[:, None, None], R * R.new_tensor([1.0, -1.0, -1.0]), R)
    z = R[:, :, 2]
    x = z * z[:, 2:] - z.new_tensor([0.0, 0.0, 1.0])
    norm = x.norm(dim=-1, keepdim=True)
    x = torch.where(norm > 1e-3, x / norm.clamp_min(1e-3), R[:, :, 0])
    facing = torch.stack([x, torch.cross(z, x, dim=-1), z], dim=-1)
    return torch.where(_among(category, UNCUED)[:, None, None], facing, R)


def ambiguity(batch: CloudBatch) -> Tensor:
    """S (B, 3) in {0, 1}: the axes about which this view leaves the pose ambiguous."""
    z = batch.R[:, :, 2]
    sine = torch.cross(batch.direction[:, :3], z, dim=-1).norm(dim=-1)
    observable = (batch.spin_pixels >= SPIN_PIXELS) | ((batch.direction[:, 3] > 0) & (sine > 0.3))
    about_z = _among(batch.category, UNCUED) | (_among(batch.category, CUED) & ~observable)
    about_x = _among(batch.category, TWOFOLD)
    return torch.stack([about_x, torch.zeros_like(about_x), about_z], -1).float()


def context(batch: CloudBatch) -> Tensor:
    """The network's context token of a training batch."""
    return context_input(batch.cloud, batch.visible)


def pose_loss(
    net: nn.Module, batch: CloudBatch, draws: int, generator: torch.Generator, process: Process
) -> tuple[Tensor, dict[str, Tensor]]:
    """The training loss of the pose network.

    Args:
        net: The network, possibly compiled.
        batch: The clouds.
        draws: Noise draws per cloud.
        generator: Random numbers, on the clouds' device.
        process: The generative process.

    Returns:
        The sum of the process's matching loss, the regression's, its sigmas' likelihood and the validity's cross
        entropy; and each part by name.
    """
    device = batch.points.device
    S = ambiguity(batch)
    R = canonical_rotation(batch.R, batch.category)
    target = encode(R, batch.p, S)
    noised = process.noised(target, draws, generator)
    autocast = torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda")
    with autocast:
        seen = Seen.of(batch.cloud, batch.category, batch.direction, context(batch))
        velocity, regression = net(seen, noised.u, noised.t)
    positive = batch.positive.float()
    count = positive.sum().clamp_min(1)

    weight = torch.ones(DIM, device=device)
    weight[AMBIGUOUS] = 0.3
    error = (velocity.float() - noised.goal).square() * weight
    flow = (error.mean((1, 2)) * positive).sum() / count

    mean = regression["mean"]
    spin_told = 1 - S[:, 2] * _among(batch.category, CUED).float()
    direct = (mean[:, AXIS_Z] - target[:, AXIS_Z]).square().sum(-1)
    direct = direct + spin_told * (mean[:, AXIS_X] - target[:, AXIS_X]).square().sum(-1)
    direct = direct + F.smooth_l1_loss(mean[:, POSITION], target[:, POSITION], reduction="none", beta=0.2).sum(-1)
    direct = direct + 0.3 * F.binary_cross_entropy_with_logits(mean[:, AMBIGUOUS], S, reduction="none").sum(-1)
    direct = (direct * positive).sum() / count

    with torch.no_grad():
        R_mean, p_mean, _ = decode(mean)
        e_position = ((p_mean - batch.p).norm(dim=-1) / 0.02).clamp(max=5)
        e_axis = _angle(R_mean[:, :, 2], R[:, :, 2])
        # The spin error after aligning the z axes, to first order: the angle between the x axes.
        e_spin = _angle(R_mean[:, :, 0], R[:, :, 0]) * spin_told
    log_sigma = regression["log_sigma"]
    squared = torch.stack([e_position, e_axis, e_spin], -1).square()
    free = log_sigma.new_tensor([3.0, 2.0, 1.0])
    likelihood = free * log_sigma + 0.5 * squared * torch.exp(-2 * log_sigma)
    likelihood = likelihood * torch.stack([torch.ones_like(spin_told), torch.ones_like(spin_told), spin_told], -1)
    likelihood = (likelihood.sum(-1) * positive).sum() / count

    valid = F.binary_cross_entropy_with_logits(regression["valid"], positive)
    loss = flow + 0.5 * direct + 0.05 * likelihood + 0.1 * valid
    parts = {"loss": loss, "flow": flow, "direct": direct, "likelihood": likelihood, "valid": valid}
    return loss, {k: v.detach() for k, v in parts.items()}


def _among(category: Tensor, rows: list[int]) -> Tensor:
    """Which of the categories (B,) are in a list of indices, (B,) bool."""
    found = torch.zeros_like(category, dtype=torch.bool)
    for row in rows:
        found = found | (category == row)
    return found


def _angle(a: Tensor, b: Tensor) -> Tensor:
    return torch.atan2(torch.cross(a, b, dim=-1).norm(dim=-1), (a * b).sum(-1))
