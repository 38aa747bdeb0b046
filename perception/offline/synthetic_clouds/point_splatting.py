"""Z-buffer splatting of surface samples, a time-of-flight sensor's noise and imperfect masks, batched in torch.

The sensor model is that of `toolee_robot.depth_noise` (Kinect v2), on small windows around the EE.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import torch
import torch.nn.functional as F
from torch import Tensor

from toolee_robot.depth_noise import (
    AXIAL_MM,
    COMMON,
    GRAZING_WIDTH,
    NEAREST,
    NOTHING,
    OUT_OF_PHASE,
    RANGES,
    STEEPEST,
    SYSTEMATIC,
    DepthNoise,
)
from toolee_robot.perception.offline.synthetic_clouds import point_splatting
from toolee_robot.perception.offline.synthetic_clouds.batch import TorchRng
from toolee_robot.perception.pose.canonical import surface_step

GRID = 112
"""Pixels per side of the window around the EE."""

_STEP = 2e-5
"""Depth [m] per unit of the z-buffer's integer key."""
_EMPTY = 2**31 - 1
_SPARE = 1 << 16
_ANGLES = 8
"""Number of steps in which the cosine of the incidence is stored."""

_NOMINAL = DepthNoise()

TARGET, TARGET_TELLS_SPIN, TOOL, HAND, OCCLUDER, BACKGROUND = 1, 2, 3, 4, 5, 6


@dataclass(frozen=True)
class Window:
    """Pinhole windows of a batch.

    Attributes:
        f: Focal length, (B,) [px].
        u0: Column of the first pixel relative to the principal point, (B,).
        v0: Row of the first pixel relative to the principal point, (B,).
    """

    f: Tensor
    u0: Tensor
    v0: Tensor

    @staticmethod
    def about(place: Tensor, depth: Tensor, f: Tensor) -> Window:
        """Windows of focal lengths f [px] whose middle is where places (B, 3) are seen at depths (B,)."""
        u0, v0 = ((f * place[:, k] / depth).round() - GRID // 2 for k in (0, 1))
        return Window(f, u0, v0)

    def rays(self) -> Tensor:
        """Directions through the pixel centres with z = 1, (B, GRID, GRID, 3)."""
        k = torch.arange(GRID, device=self.f.device, dtype=torch.float32)
        x = ((k[None] + self.u0[:, None]) / self.f[:, None])[:, None, :].expand(-1, GRID, -1)
        y = ((k[None] + self.v0[:, None]) / self.f[:, None])[:, :, None].expand(-1, -1, GRID)
        return torch.stack([x, y, torch.ones_like(x)], dim=-1)


class ZBuffer:
    """Nearest surface per pixel: depth, label and incidence packed in one int32, so that one atomic minimum updates it.

    Args:
        window: The pixels.
    """

    def __init__(self, window: Window) -> None:
        self.window = window
        self._B = len(window.f)
        # Spare pixels at the end take points that fall outside; many, because atomics on one address serialise.
        self.keys = torch.full((self._B * GRID * GRID + _SPARE,), _EMPTY, dtype=torch.int32, device=window.f.device)

    def copy(self) -> ZBuffer:
        """A copy with the same content."""
        other = ZBuffer(self.window)
        other.keys.copy_(self.keys)
        return other

    def draw(self, points: Tensor, labels: Tensor, normals: Tensor | None, reach: int) -> None:
        """Splat points on the nearest (2 reach)^2 pixels.

        With normals, back faces are culled and the depth follows the tangent plane to the pixel's centre.

        Args:
            points: (B, N, 3) [m], camera frame.
            labels: (B, N).
            normals: (B, N, 3), or None.
            reach: Half of the splat's width [px].
        """
        splat = _compiled_splat() if points.is_cuda else _splat
        splat(self.keys, self.window.f, self.window.u0, self.window.v0, points, labels, normals, reach)

    def fill(self, depth: Tensor, inside: Tensor, label: int) -> None:
        """Draw a surface where nothing is nearer.

        Args:
            depth: (B, GRID, GRID) [m].
            inside: Its pixels, (B, GRID, GRID) bool.
            label: Its label.
        """
        key = (depth.clamp(0.1, 8.0) / _STEP).int() * (8 * _ANGLES) + label * _ANGLES + int(0.8 * _ANGLES)
        key = torch.where(inside, key, torch.full_like(key, _EMPTY))
        drawn = self.keys[: key.numel()]
        torch.minimum(drawn, key.flatten(), out=drawn)

    def images(self) -> tuple[Tensor, Tensor, Tensor]:
        """Depth [m] (0: empty), label (0: empty) and cosine of the incidence, (B, GRID, GRID) each."""
        keys = self.keys[: self._B * GRID * GRID].view(self._B, GRID, GRID)
        empty = keys == _EMPTY
        depth = torch.where(empty, 0.0, (keys // (8 * _ANGLES)).float() * _STEP)
        label = torch.where(empty, 0, keys // _ANGLES % 8)
        return depth, label, ((keys % _ANGLES).float() + 0.5) / _ANGLES


def _splat(
    keys: Tensor, f: Tensor, u0: Tensor, v0: Tensor, points: Tensor, labels: Tensor, normals: Tensor | None, reach: int
) -> None:
    """See `ZBuffer.draw`."""
    x, y, z = points.unbind(-1)
    seen = z > 0.1
    safe = z.clamp_min(0.1)
    u = f[:, None] * x / safe - u0[:, None]
    v = f[:, None] * y / safe - v0[:, None]
    if normals is not None:
        facing = -(normals * points).sum(-1)
        cosine = facing / points.norm(dim=-1).clamp_min(1e-6)
        seen = seen & (cosine > 0.02)
        angle = (cosine.clamp(0, 0.999) * _ANGLES).int()
    else:
        angle = torch.full_like(labels, int(0.7 * _ANGLES), dtype=torch.int32)
    low = labels.int() * _ANGLES + angle
    batch = torch.arange(len(f), device=z.device)[:, None] * (GRID * GRID)
    spare = (torch.arange(z.numel(), device=z.device) % _SPARE + len(f) * GRID * GRID).view(z.shape)
    for dj in range(1 - reach, 1 + reach):
        for di in range(1 - reach, 1 + reach):
            i, j = u.floor().long() + di, v.floor().long() + dj
            near = seen & ((i - u).abs() <= reach - 0.25) & ((j - v).abs() <= reach - 0.25)
            near = near & (i >= 0) & (i < GRID) & (j >= 0) & (j < GRID)
            depth = z
            if normals is not None:
                rx = (i + u0[:, None]) / f[:, None]
                ry = (j + v0[:, None]) / f[:, None]
                along = -(normals[..., 0] * rx + normals[..., 1] * ry + normals[..., 2])
                plane = facing / torch.where(along.abs() < 1e-4, torch.full_like(along, 1e-4), along)
                depth = torch.where((plane - z).abs() < 0.004, plane, z)
            key = (depth.clamp(0.1, 8.0) / _STEP).int() * (8 * _ANGLES) + low
            index = torch.where(near, batch + j * GRID + i, spare)
            keys.scatter_reduce_(0, index.flatten(), key.flatten(), "amin")


@lru_cache(maxsize=1)
def _compiled_splat() -> Callable[..., None]:
    """The splat compiled: fused, nearly twice as fast. A generator's shapes never change."""
    return torch.compile(_splat, dynamic=False)


def measure(
    depth: Tensor, cosine: Tensor, shininess: Tensor, f: Tensor, generator: torch.Generator, level: float | None = None
) -> Tensor:
    """Simulate a depth sensor's reading.

    Args:
        depth: True depth, (B, GRID, GRID) [m], 0 where empty.
        cosine: Cosine of the incidence, (B, GRID, GRID).
        shininess: In [0, 1], (B,).
        f: Focal length, (B,) [px].
        generator: Random numbers, on the depth's device.
        level: Factor on the nominal sensor's noise (0: none); None: a random sensor per cloud.

    Returns:
        Measured depth, (B, GRID, GRID) [m], 0 where there is none.
    """
    B, device = len(depth), depth.device

    def uniform(name: str) -> Tensor:
        if level is not None:
            return torch.full((B, 1, 1), getattr(_NOMINAL, name) * min(level, 1.0), device=device)
        low, high = RANGES[name]
        return low + (high - low) * torch.rand(B, 1, 1, device=device, generator=generator)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, device=device, generator=generator)

    def chance() -> Tensor:
        return torch.rand(depth.shape, device=device, generator=generator)

    axial = uniform("axial") * (max(level, 1.0) if level is not None else 1.0)
    share, lateral = uniform("correlation"), uniform("lateral")
    mixed, edge_dropout = uniform("mixed"), uniform("edge_dropout")
    shiny, lost = uniform("shiny_dropout"), uniform("random_dropout")
    if level is None:
        grazing = torch.deg2rad(uniform("grazing_deg"))
        bias, scale = (SYSTEMATIC * normal(B, 1, 1) for _ in range(2))
    else:
        grazing = torch.full((B, 1, 1), _NOMINAL.grazing, device=device)
        bias = scale = torch.zeros(B, 1, 1, device=device)

    # Lateral jitter frays outlines.
    sigma = lateral * f[:, None, None] / depth.clamp_min(NEAREST)
    k = torch.arange(GRID, device=device)
    rows = (k[None, :, None] + normal(B, GRID, GRID) * sigma).round().long().clamp(0, GRID - 1)
    columns = (k[None, None] + normal(B, GRID, GRID) * sigma).round().long().clamp(0, GRID - 1)
    other = depth.flatten(1).gather(1, (rows * GRID + columns).flatten(1)).view_as(depth)
    seen = torch.where(((other - depth).abs() > _NOMINAL.edge_step) & (depth > 0), other, depth)

    filled = torch.where(seen > 0, seen, NOTHING)[:, None]
    high = F.max_pool2d(filled, 3, 1, 1)[:, 0]
    low = -F.max_pool2d(-filled, 3, 1, 1)[:, 0]
    edge = (high - low > _NOMINAL.edge_step) & (seen > 0)

    theta = torch.acos(cosine).clamp(max=STEEPEST)
    a, b, c, d = AXIAL_MM
    slant = theta / (torch.pi / 2 - theta)
    sigma_z = 1e-3 * (a + b * seen + c * seen * seen + d * seen * seen.sqrt() * slant**2)
    noise = (1 - share).sqrt() * normal(B, GRID, GRID) + share.sqrt() * smooth_noise(B, COMMON, generator, device)
    out = seen * (1 + scale) + bias + axial * sigma_z * noise

    weight = chance()
    weight = torch.where(weight < 0.5, 2 * weight * weight, 1 - 2 * (1 - weight) ** 2)
    mixture = torch.where(high - low > OUT_OF_PHASE, 0.0, low + weight * (high - low))
    out = torch.where(edge & (chance() < mixed) & (weight > 0.5), mixture, out)
    drop = edge & (chance() < edge_dropout)
    drop |= chance() < lost
    drop |= chance() < shiny * shininess[:, None, None] * theta.sin()
    drop |= chance() < torch.sigmoid((theta - grazing) / GRAZING_WIDTH)
    return torch.where(drop | (out < _NOMINAL.minimum) | (seen <= 0) | (depth <= 0), 0.0, out)


def smooth_noise(B: int, sigma: float, generator: torch.Generator, device: torch.device) -> Tensor:
    """Spatially correlated noise of unit variance.

    Args:
        B: Number of images.
        sigma: Standard deviation of the Gaussian kernel [px]; the correlation reaches about twice as far.
        generator: Random generator, on `device`.
        device: torch device of the noise.

    Returns:
        The noise, (B, GRID, GRID).
    """
    half = round(3 * sigma)
    k = torch.exp(-0.5 * (torch.arange(-half, half + 1, device=device) / sigma) ** 2)
    k = k / k.norm()
    white = torch.randn(B, 1, GRID, GRID, device=device, generator=generator)
    rows = F.conv2d(white, k.view(1, 1, 1, -1), padding=(0, half))
    return F.conv2d(rows, k.view(1, 1, -1, 1), padding=(half, 0))[:, 0]


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
