"""Training clouds made on the device as they are needed: nothing is stored, every cloud is new.

A tool at a random pose, a hand on its handle, an occluder now and then, a background; seen by a depth camera and cut
out by an imperfect mask. A share are negatives: clouds of hands, of other parts, or of another category's EE.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from toolee_robot.perception.pose import splat
from toolee_robot.perception.pose.bank import Float32, ToolBank, random_grasps
from toolee_robot.perception.pose.canonical import MIN_POINTS, canonicalize
from toolee_robot.perception.pose.splat import GRID, Window, ZBuffer
from toolee_robot.tools.model import ee_radius
from toolee_robot.types import Category

_INPUT = 1024
_CATEGORY_SHARE = {
    Category.HAMMER_HEAD: 0.36,
    Category.HAMMER_GRIP: 0.18,
    Category.SCREWDRIVER_HEAD: 0.20,
    Category.WRENCH_HEAD: 0.26,
}


@dataclass(frozen=True)
class CloudConfig:
    """What is varied. distance [m], focal [px]; shares are probabilities. sensor_level: None for random sensors."""

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


@dataclass(frozen=True)
class CloudBatch:
    """Canonical clouds and their truth, all tensors with the batch first.

    points (B, 512, 3), centre (B, 3), R_canonical (B, 3, 3): see `canonical.CanonicalCloud`. R (B, 3, 3), p (B, 3):
    the EE's pose in the canonical frame. direction (B, 5): the token, given for all. tells_spin (B,): pixels in the
    mask that tell the spin. category, item (B,); positive (B,): whether it is that category's EE at all;
    visible (B,): native points; occlusion (B,) in [0, 1]; distance (B,) [m].
    """

    points: Tensor
    centre: Tensor
    R_canonical: Tensor
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

    def select(self, index: Tensor) -> CloudBatch:
        """The rows of an index or mask."""
        return CloudBatch(*(getattr(self, f.name)[index] for f in fields(self)))

    @staticmethod
    def cat(batches: list[CloudBatch]) -> CloudBatch:
        return CloudBatch(*(torch.cat([getattr(b, f.name) for b in batches]) for f in fields(CloudBatch)))


class CloudGenerator:
    """Endless clouds of one bank on one device, from one seed."""

    def __init__(
        self,
        bank: ToolBank,
        hands: Float32,
        device: torch.device | str,
        seed: int,
        config: CloudConfig | None = None,
    ) -> None:
        self.config = config or CloudConfig()
        self._device = torch.device(device)
        self._g = torch.Generator(self._device).manual_seed(seed)
        self._rng = np.random.default_rng(seed)
        self._bank = bank

        def put(x: np.ndarray) -> Tensor:
            return torch.as_tensor(x, device=self._device)

        self._ee, self._normals, self._tells = put(bank.ee_points), put(bank.ee_normals), put(bank.asymmetric)
        self._rest, self._X_ee_tool = put(bank.rest), put(bank.X_ee_tool)
        self._category, self._shininess = put(bank.category), put(bank.shininess)
        self._hands, self._handle = put(hands), put(bank.handle)
        categories = list(Category)
        self._radius = put(np.array([ee_radius(c) for c in categories], np.float32))
        counts = np.bincount(bank.category, minlength=len(categories))
        share = np.array([_CATEGORY_SHARE[c] for c in categories])
        self._weights = share[bank.category] / counts[bank.category]
        self._weights /= self._weights.sum()

    def reseed(self, seed: int) -> None:
        """Start another sequence of clouds."""
        self._g.manual_seed(seed)
        self._rng = np.random.default_rng(seed)

    def generate(self, n: int) -> CloudBatch:
        """Up to n clouds: those that show too little are dropped."""
        with torch.no_grad():
            return self._generate(n)

    def collect(self, n: int, chunk: int) -> CloudBatch:
        """Exactly n clouds, made `chunk` at a time."""
        batches: list[CloudBatch] = []
        while sum(map(len, batches)) < n:
            batches.append(self.generate(chunk))
        return CloudBatch.cat(batches).select(torch.arange(n, device=self._device))

    def _uniform(self, n: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * torch.rand(n, device=self._device, generator=self._g)

    def _normal(self, *shape: int) -> Tensor:
        return torch.randn(*shape, device=self._device, generator=self._g)

    def _generate(self, B: int) -> CloudBatch:
        c, device = self.config, self._device
        item_np = self._rng.choice(len(self._weights), B, p=self._weights)
        item = torch.as_tensor(item_np, device=device)
        X_ee_tool = self._X_ee_tool[item]
        X_tool_hand = torch.as_tensor(random_grasps(self._bank.handle[item_np], self._rng), device=device)

        # The pose in the camera's frame, full SO(3).
        f_native = torch.where(self._uniform(B) < c.kinect_share, 365.5, self._uniform(B, *c.focal))
        near = self._uniform(B) < c.near_share
        distance = torch.where(near, self._uniform(B, c.distance[0], c.near), self._uniform(B, *c.distance))
        R = _random_rotations(self._normal(B, 4))
        ray = torch.stack([self._uniform(B, -0.5, 0.5), self._uniform(B, -0.42, 0.42), torch.ones_like(distance)], -1)
        p = ray * distance[:, None]

        ee = torch.einsum("bij,bnj->bni", R, self._ee[item]) + p[:, None]
        normals = torch.einsum("bij,bnj->bni", R, self._normals[item])
        rest = torch.einsum("bij,bnj->bni", R, self._rest[item]) + p[:, None]
        X_ee_hand = X_ee_tool @ X_tool_hand
        R_hand = R @ X_ee_hand[:, :3, :3]
        p_hand = torch.einsum("bij,bj->bi", R, X_ee_hand[:, :3, 3]) + p
        which = torch.randint(len(self._hands), (B,), device=device, generator=self._g)
        hand = torch.einsum("bij,bnj->bni", R_hand, self._hands[which]) + p_hand[:, None]
        has_hand = self._uniform(B) < c.hand_share
        hand = torch.where(has_hand[:, None, None], hand, hand.new_tensor([0.0, 0.0, -1.0]))

        # Negatives: another category claimed; or the mask is on the hand, or on another part of the tool.
        kind = self._uniform(B) / max(c.negative_share, 1e-9)
        swapped = kind < 0.5
        claimed = torch.where(
            swapped,
            (self._category[item] + torch.randint(1, len(Category), (B,), device=device, generator=self._g))
            % len(Category),
            self._category[item],
        )
        on_hand = (kind >= 0.5) & (kind < 0.75) & has_hand
        on_rest = (kind >= 0.75) & (kind < 1.0)
        spot = torch.randint(rest.shape[1], (B,), device=device, generator=self._g)
        batch = torch.arange(B, device=device)
        focus = torch.where(on_rest[:, None], rest[batch, spot], p)
        # On the handle only: the other end may be an EE of the same category.
        X_tool_ee = _rigid_inverse(X_ee_tool)
        height = (X_tool_ee[:, 2, :3] * self._rest[item, spot]).sum(-1) + X_tool_ee[:, 2, 3]
        on_handle = (height > self._handle[item, 0] + 0.03) & (height < self._handle[item, 1] - 0.03)
        focus = torch.where(on_hand[:, None], hand[batch, spot], focus)
        far_enough = (focus - p).norm(dim=-1) > 0.07
        positive = ~(swapped | on_hand | on_rest)
        radius = self._radius[claimed]

        half = 1.35 * radius
        depth_focus = focus[:, 2].clamp_min(0.15)
        f = torch.minimum(f_native, GRID / 2 * depth_focus / half)
        window = Window(
            f,
            (f * focus[:, 0] / depth_focus).round() - GRID // 2,
            (f * focus[:, 1] / depth_focus).round() - GRID // 2,
        )
        tool_target = ~on_hand

        def label(points: Tensor, usual: int, target: Tensor, tells: Tensor | None = None) -> Tensor:
            inside = ((points - focus[:, None]).norm(dim=-1) < radius[:, None]) & target[:, None]
            hit = torch.full_like(inside, splat.TARGET, dtype=torch.int32)
            if tells is not None:
                hit = torch.where(tells, splat.TARGET_TELLS_SPIN, hit)
            return torch.where(inside, hit, usual)

        alone = ZBuffer(window)
        alone.draw(ee, label(ee, splat.TOOL, tool_target, self._tells[item]), normals, 1)
        alone.draw(rest, label(rest, splat.TOOL, tool_target), None, 2)
        buffer = alone.copy()
        buffer.draw(hand, label(hand, splat.HAND, on_hand), None, 2)
        rays = window.rays()
        self._occluders(buffer, focus, radius, rays)
        self._backgrounds(buffer, focus, rays)

        _, label_alone, _ = alone.images()
        truth, labels, cosine = buffer.images()
        unoccluded = _is_target(label_alone).sum((1, 2)).clamp_min(1)
        target = _is_target(labels)
        occlusion = 1 - target.sum((1, 2)) / unoccluded
        level = c.sensor_level
        depth = splat.measure(truth, cosine, self._shininess[item], f, self._g, level)
        depth = torch.where(self._cleaned(depth), depth, 0.0)
        mask = self._imperfect(target)

        usable = mask & (depth > 0)
        points, valid, count = _pick(usable, depth, rays)
        cloud = canonicalize(points, valid, radius, self._g)
        visible = cloud.count / valid.sum(1).clamp_min(1) * count * (f_native / f) ** 2
        tells_spin = (usable & (labels == splat.TARGET_TELLS_SPIN)).sum((1, 2))
        direction = self._directions(cloud.centre, cloud.R, rest, p_hand, has_hand, X_ee_tool, R, p, X_tool_hand)

        shows = (cloud.count >= 0.6 * MIN_POINTS) & (visible >= MIN_POINTS)
        shows &= torch.where(
            positive, occlusion <= c.max_occlusion, swapped | (on_hand & far_enough) | (on_rest & on_handle)
        )
        # Where the mask slid off the EE altogether, what is left is no positive.
        shows &= ~positive | ((mask & target).sum((1, 2)) > 0.3 * mask.sum((1, 2)))
        result = CloudBatch(
            points=cloud.points,
            centre=cloud.centre,
            R_canonical=cloud.R,
            R=cloud.R @ R,
            p=torch.einsum("bij,bj->bi", cloud.R, p - cloud.centre),
            direction=direction,
            tells_spin=tells_spin,
            category=claimed,
            item=item,
            positive=positive,
            visible=visible,
            occlusion=occlusion,
            distance=distance,
        )
        return result.select(shows)

    def _occluders(self, buffer: ZBuffer, focus: Tensor, radius: Tensor, rays: Tensor) -> None:
        """Ellipses that float between the camera and the EE."""
        B = len(focus)
        z = focus[:, 2]
        around = rays[..., :2] * z[:, None, None, None] - focus[:, None, None, :2]
        offset = self._normal(B, 2) * 0.8 * radius[:, None]
        d = around - offset[:, None, None]
        angle = self._uniform(B, 0, 2 * torch.pi)[:, None, None]
        a = d[..., 0] * angle.cos() + d[..., 1] * angle.sin()
        b = d[..., 1] * angle.cos() - d[..., 0] * angle.sin()
        size_a, size_b = self._uniform(B, 0.006, 0.06)[:, None, None], self._uniform(B, 0.006, 0.03)[:, None, None]
        present = (self._uniform(B) < self.config.occluder_share)[:, None, None]
        inside = present & ((a / size_a) ** 2 + (b / size_b) ** 2 < 1)
        slope = self._normal(B, 2) * 0.3
        depth = (z - self._uniform(B, 0.02, 0.25))[:, None, None] + (d * slope[:, None, None]).sum(-1)
        buffer.fill(depth, inside, splat.OCCLUDER)

    def _backgrounds(self, buffer: ZBuffer, focus: Tensor, rays: Tensor) -> None:
        """A tilted plane behind the tool, near or far, or nothing."""
        B = len(focus)
        gap = torch.exp(self._uniform(B, float(np.log(0.05)), float(np.log(2.0))))
        around = rays[..., :2] * focus[:, 2, None, None, None] - focus[:, None, None, :2]
        slope = self._normal(B, 2) * 0.5
        depth = (focus[:, 2] + gap)[:, None, None] + (around * slope[:, None, None]).sum(-1)
        present = (self._uniform(B) < 0.85)[:, None, None]
        buffer.fill(depth, present.expand_as(depth), splat.BACKGROUND)

    def _cleaned(self, depth: Tensor) -> Tensor:
        """Which pixels are left (B, GRID, GRID): in most clouds those that hang between surfaces are removed, as
        `toolee_robot.perception.cloud` does."""
        limit = 0.012 + 0.01 * depth
        padded = torch.nn.functional.pad(depth, (1, 1, 1, 1))
        near = torch.zeros_like(depth)
        for dj in range(3):
            for di in range(3):
                if (dj, di) != (1, 1):
                    near += ((padded[:, dj : dj + GRID, di : di + GRID] - depth).abs() < limit).float()
        as_seen = (self._uniform(len(depth)) < 1 - self.config.cleaned_share)[:, None, None]
        return as_seen | (near >= 2)

    def _imperfect(self, target: Tensor) -> Tensor:
        """Predicted masks: grown or shrunk by a pixel or three, ragged, shifted, now and then a piece missing."""
        B, device = len(target), target.device
        wrong = (self._uniform(B) < self.config.mask_error_share)[:, None, None]
        shift = torch.randint(-1, 2, (B, 2), device=device, generator=self._g) * (self._uniform(B, 0, 1) < 0.3)[:, None]
        k = torch.arange(GRID, device=device)
        rows = (k[None] + shift[:, :1]).clamp(0, GRID - 1)[:, :, None]
        columns = (k[None] + shift[:, 1:]).clamp(0, GRID - 1)[:, None, :]
        moved = target[torch.arange(B, device=device)[:, None, None], rows, columns].float()[:, None]
        narrow = torch.nn.functional.avg_pool2d(moved, 3, 1, 1)[:, 0]
        wide = torch.nn.functional.avg_pool2d(moved, 7, 1, 3)[:, 0]
        soft = torch.where((self._uniform(B) < 0.5)[:, None, None], narrow, wide)
        ragged = splat.smooth_noise(B, 3.0, self._g, device) * self._uniform(B, 0, 0.2)[:, None, None]
        grown = (soft > 0) & (soft + ragged > self._uniform(B, 0.12, 0.75)[:, None, None])
        # Chunks: everything beyond a line through the mask.
        cut = wrong & (self._uniform(B) < self.config.chunk_share)[:, None, None]
        angle = self._uniform(B, 0, 2 * torch.pi)[:, None, None]
        x, y = k[None, None, :] - GRID / 2, k[None, :, None] - GRID / 2
        along = x * angle.cos() + y * angle.sin()
        spread = (along.abs() * target).sum((1, 2)) / target.sum((1, 2)).clamp_min(1)
        missing = cut & (along > (self._uniform(B, -0.3, 1.2) * spread)[:, None, None])
        return torch.where(wrong, grown, target) & ~missing

    def _directions(
        self,
        centre: Tensor,
        R_canonical: Tensor,
        rest: Tensor,
        p_hand: Tensor,
        has_hand: Tensor,
        X_ee_tool: Tensor,
        R: Tensor,
        p: Tensor,
        X_tool_hand: Tensor,
    ) -> Tensor:
        """Tokens (B, 5): to the mean of some visible stretch of the rest of the tool, or to the hand; noisy."""
        B = len(centre)
        X_tool_ee = _rigid_inverse(X_ee_tool)
        height = torch.einsum("bj,bnj->bn", torch.einsum("bi,bji->bj", X_tool_ee[:, 2, :3], R), rest - p[:, None])
        height = height + X_tool_ee[:, 2, 3, None]
        low, high = height.min(1).values, height.max(1).values
        length = high - low
        a = low + length * self._uniform(B, 0.0, 0.5) * (self._uniform(B) < 0.6)
        b = high - length * self._uniform(B, 0.0, 0.4) * (self._uniform(B) < 0.6)
        kept = (height >= a[:, None]) & (height <= b[:, None])
        under_hand = (height - X_tool_hand[:, 2, 3, None]).abs() < 0.045
        hides = has_hand & (self._uniform(B) < 0.85)
        kept &= ~(under_hand & hides[:, None])
        mean = (rest * kept[..., None]).sum(1) / kept.sum(1, keepdim=True).clamp_min(1)
        by_hand = (self._uniform(B) < 0.3) | (kept.sum(1) < 20)
        goal = torch.where(by_hand[:, None], p_hand + 0.01 * self._normal(B, 3), mean)
        d = torch.nn.functional.normalize(goal - centre, dim=-1)
        sigma = torch.where(self._uniform(B) < 0.1, 0.35, 0.10)[:, None]
        d = torch.nn.functional.normalize(d + sigma * self._normal(B, 3), dim=-1)
        d = torch.einsum("bij,bj->bi", R_canonical, d)
        return torch.cat([d, torch.ones_like(d[:, :1]), by_hand.float()[:, None]], dim=-1)


def _is_target(labels: Tensor) -> Tensor:
    return (labels == splat.TARGET) | (labels == splat.TARGET_TELLS_SPIN)


def _rigid_inverse(X: Tensor) -> Tensor:
    Y = X.clone()
    Y[:, :3, :3] = X[:, :3, :3].mT
    Y[:, :3, 3] = -torch.einsum("bji,bj->bi", X[:, :3, :3], X[:, :3, 3])
    return Y


def _random_rotations(q: Tensor) -> Tensor:
    w, x, y, z = torch.nn.functional.normalize(q, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).view(-1, 3, 3)


def _pick(usable: Tensor, depth: Tensor, rays: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Up to 1024 of the usable pixels, evenly: points (B, 1024, 3), which are real (B, 1024), pixels in all (B,)."""
    order = usable.flatten(1).int().cumsum(1, dtype=torch.int32)
    count = order[:, -1]
    k = torch.arange(_INPUT, device=depth.device)
    stride = (count.float() / _INPUT).clamp_min(1.0)
    rank = (k[None] * stride[:, None]).int() + 1
    valid = rank <= count[:, None]
    pixel = torch.searchsorted(order, rank).clamp(max=GRID * GRID - 1)
    z = depth.flatten(1).gather(1, pixel)
    direction = rays.flatten(1, 2).gather(1, pixel[..., None].expand(-1, -1, 3))
    return direction * z[..., None], valid, count
