"""Imperfect masks and the removal of flying pixels, on splatted windows."""

from __future__ import annotations

import torch
from torch import Tensor

from toolee_robot.perception.offline.synthetic_clouds import point_splatting
from toolee_robot.perception.offline.synthetic_clouds.batch import TorchRng
from toolee_robot.perception.offline.synthetic_clouds.point_splatting import GRID
from toolee_robot.perception.pose.depth_completion import surface_step


def cleaned(depth: Tensor, share: float, torch_rng: TorchRng) -> Tensor:
    """Remove flying pixels in a share of the clouds, as `toolee_robot.perception.cloud` does.

    Args:
        depth: (B, GRID, GRID) [m], 0 where unknown.
        share: Share of the clouds that are cleaned.
        torch_rng: Random numbers.

    Returns:
        Which pixels are left, (B, GRID, GRID) bool.
    """
    limit = surface_step(depth)
    padded = torch.nn.functional.pad(depth, (1, 1, 1, 1))
    near = torch.zeros_like(depth)
    for dj in range(3):
        for di in range(3):
            if (dj, di) != (1, 1):
                near += ((padded[:, dj : dj + GRID, di : di + GRID] - depth).abs() < limit).float()
    as_seen = (torch_rng.uniform(len(depth)) < 1 - share)[:, None, None]
    return as_seen | (near >= 2)


def imperfect(target: Tensor, error_share: float, chunk_share: float, torch_rng: TorchRng) -> Tensor:
    """Make masks as a detector predicts them.

    Grown or shrunk by up to three pixels, ragged, shifted, sometimes a piece missing.

    Args:
        target: True masks, (B, GRID, GRID) bool.
        error_share: Share of imperfect masks.
        chunk_share: Share of these that miss a piece.
        torch_rng: Random numbers.

    Returns:
        The masks, (B, GRID, GRID) bool.
    """
    B, device = len(target), target.device
    wrong = (torch_rng.uniform(B) < error_share)[:, None, None]
    shift = torch_rng.integers(-1, 2, B, 2) * (torch_rng.uniform(B, 0, 1) < 0.3)[:, None]
    k = torch.arange(GRID, device=device)
    rows = (k[None] + shift[:, :1]).clamp(0, GRID - 1)[:, :, None]
    columns = (k[None] + shift[:, 1:]).clamp(0, GRID - 1)[:, None, :]
    moved = target[torch.arange(B, device=device)[:, None, None], rows, columns].float()[:, None]
    narrow = torch.nn.functional.avg_pool2d(moved, 3, 1, 1)[:, 0]
    wide = torch.nn.functional.avg_pool2d(moved, 7, 1, 3)[:, 0]
    soft = torch.where((torch_rng.uniform(B) < 0.5)[:, None, None], narrow, wide)
    ragged = (
        point_splatting.smooth_noise(B, 3.0, torch_rng.generator, device) * torch_rng.uniform(B, 0, 0.2)[:, None, None]
    )
    grown = (soft > 0) & (soft + ragged > torch_rng.uniform(B, 0.12, 0.75)[:, None, None])
    # A missing piece is everything beyond a line through the mask.
    cut = wrong & (torch_rng.uniform(B) < chunk_share)[:, None, None]
    angle = torch_rng.uniform(B, 0, 2 * torch.pi)[:, None, None]
    x, y = k[None, None, :] - GRID / 2, k[None, :, None] - GRID / 2
    along = x * angle.cos() + y * angle.sin()
    spread = (along.abs() * target).sum((1, 2)) / target.sum((1, 2)).clamp_min(1)
    missing = cut & (along > (torch_rng.uniform(B, -0.3, 1.2) * spread)[:, None, None])
    return torch.where(wrong, grown, target) & ~missing


def pick(usable: Tensor, depth: Tensor, rays: Tensor, most: int = 1024) -> tuple[Tensor, Tensor, Tensor]:
    """Pick pixels evenly and back-project them.

    Args:
        usable: Pixels to pick from, (B, GRID, GRID) bool.
        depth: (B, GRID, GRID) [m].
        rays: Directions with z = 1, (B, GRID, GRID, 3).
        most: Largest number of points per cloud.

    Returns:
        Points (B, most, 3) [m], which of them are real (B, most), and the number of usable pixels (B,).
    """
    order = usable.flatten(1).int().cumsum(1, dtype=torch.int32)
    count = order[:, -1]
    k = torch.arange(most, device=depth.device)
    stride = (count.float() / most).clamp_min(1.0)
    rank = (k[None] * stride[:, None]).int() + 1
    valid = rank <= count[:, None]
    pixel = torch.searchsorted(order, rank).clamp(max=GRID * GRID - 1)
    z = depth.flatten(1).gather(1, pixel)
    direction = rays.flatten(1, 2).gather(1, pixel[..., None].expand(-1, -1, 3))
    return direction * z[..., None], valid, count
