"""Generator of synthetic training clouds on the device: nothing is stored, every cloud is new.

A tool at a random pose, a hand on its handle, sometimes an occluder, a background; seen by a depth camera and cut out
by an imperfect mask. A share are negatives: clouds of hands, of other parts, or of another category's EE.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from toolee_robot.end_effectors import Category
from toolee_robot.perception.offline.synthetic_clouds import point_splatting
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch, CloudConfig, CloudSource, TorchRng
from toolee_robot.perception.offline.synthetic_clouds.point_splatting import (
    GRID,
    Window,
    ZBuffer,
    cleaned,
    imperfect,
    pick,
)
from toolee_robot.perception.offline.synthetic_clouds.scene import (
    Border,
    Cut,
    Placement,
    Target,
    directions,
    draw_backgrounds,
    draw_occluders,
    rigid_inverse,
)
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import (
    NOWHERE,
    Float32,
    SurfaceSamples,
    random_grasps,
)
from toolee_robot.perception.pose.canonical import (
    MIN_KEPT,
    MIN_POINTS,
    CanonicalCloud,
    canonicalize,
    complete_depth,
    with_rest,
)

_MAX_COMPLETED = 512
_EE_REACH, _TOOL_REACH = 2, 1
"""Reach of splats [px] in a window that holds an EE, and a whole tool: there wider ones would thicken thin parts."""


class CloudGenerator(CloudSource):
    """Endless synthetic clouds from surface samples, on one device, from one seed.

    Args:
        samples: Surface samples of tools.
        hands: Surface samples of hands, (H, 6144, 3) [m].
        device: torch device.
        seed: Seed of all random numbers.
        config: Distributions of the clouds; None: the default.
    """

    def __init__(
        self,
        samples: SurfaceSamples,
        hands: Float32,
        device: torch.device | str,
        seed: int,
        config: CloudConfig | None = None,
    ) -> None:
        self.config = config or CloudConfig()
        self._device = torch.device(device)
        self._torch_rng = TorchRng(self._device, seed)
        self._rng = np.random.default_rng(seed)
        self._samples = samples

        def put(x: np.ndarray) -> Tensor:
            return torch.as_tensor(x, device=self._device)

        self._ee, self._normals = put(samples.ee_points), put(samples.ee_normals)
        self._asymmetric = put(samples.asymmetric)
        self._rest, self._X_ee_tool = put(samples.rest), put(samples.X_ee_tool)
        self._category, self._shininess = put(samples.category), put(samples.shininess)
        self._other_end, self._other_category = put(samples.other_end), put(samples.other_category)
        self._hands, self._handle = put(hands), put(samples.handle)
        categories = list(Category)
        radii = [self.config.radius or c.spec.radius for c in categories]
        self._radius = put(np.array(radii, np.float32))
        counts = np.bincount(samples.category, minlength=len(categories))
        share = np.array([c.spec.training_share for c in categories])
        self._weights = share[samples.category] / counts[samples.category]
        self._weights /= self._weights.sum()

    def reseed(self, seed: int) -> None:
        """See `CloudSource`."""
        self._torch_rng.generator.manual_seed(seed)
        self._rng = np.random.default_rng(seed)

    def generate(self, n: int) -> CloudBatch:
        """See `CloudSource`."""
        with torch.no_grad():
            return self._generate(n)

    def _generate(self, B: int) -> CloudBatch:
        c, torch_rng = self.config, self._torch_rng
        placed = self._place(B)
        target = self._target(placed)
        focus, radius = target.focus, target.cut.radius
        depth_focus = focus[:, 2].clamp_min(0.15)
        f = torch.minimum(placed.f_native, GRID / 2 * depth_focus / (1.35 * radius))
        window = Window.about(focus, depth_focus, f)
        alone, buffer = self._draw(placed, target, window, _EE_REACH)
        rays = window.rays()
        draw_occluders(buffer, focus, radius, rays, c.occluder_share, torch_rng)
        draw_backgrounds(buffer, focus, rays, torch_rng)

        unoccluded = _is_target(alone.images()[1]).sum((1, 2)).clamp_min(1)
        truth, labels, cosine = buffer.images()
        inside = target.border.shows(rays)
        seen = _is_target(labels) & inside
        occlusion = 1 - seen.sum((1, 2)) / unoccluded
        depth = self._measured(placed, truth, cosine, f)
        mask = imperfect(seen, c.mask_error_share, c.chunk_share, torch_rng) & inside

        usable = mask & (depth > 0)
        points, valid, count = pick(usable, depth, rays)
        completed = None
        if c.guessed:
            completed_depth = complete_depth(depth, usable, mask & ~usable)
            completed = pick(completed_depth > 0, completed_depth, rays, most=_MAX_COMPLETED)[:2]
        cloud = canonicalize(points, valid, target.radius, torch_rng.generator, c.points, c.ordered, completed)
        visible = cloud.count / valid.sum(1).clamp_min(1) * count * (placed.f_native / f) ** 2
        if c.rest:
            cloud = self._with_rest(cloud, placed, target)
        tells_spin = (usable & (labels == point_splatting.TARGET_TELLS_SPIN)).sum((1, 2))
        direction = directions(placed, cloud.centre, cloud.R, torch_rng)

        shows = (cloud.count >= MIN_KEPT) & (visible >= MIN_POINTS)
        shows &= torch.where(target.positive, occlusion <= c.max_occlusion, target.admissible)
        # A mask that slid off the EE altogether is no positive.
        shows &= ~target.positive | ((mask & seen).sum((1, 2)) > 0.3 * mask.sum((1, 2)))
        result = CloudBatch.of(
            cloud,
            placed.R,
            placed.p,
            direction=direction,
            spin_pixels=tells_spin,
            category=target.claimed,
            item=placed.item,
            positive=target.positive,
            visible=visible,
            occlusion=occlusion,
            distance=placed.distance,
        )
        return result.select(shows)

    def _with_rest(self, cloud: CanonicalCloud, placed: Placement, target: Target) -> CanonicalCloud:
        """Add the rest of the tools, seen by the same camera through a coarser window that holds the whole tool."""
        c, torch_rng = self.config, self._torch_rng
        middle = placed.rest.mean(1)
        size = (placed.rest - middle[:, None]).norm(dim=-1).amax(1).clamp_min(0.06)
        depth_middle = middle[:, 2].clamp_min(0.15)
        f = torch.minimum(placed.f_native, GRID / 2 * (depth_middle - 0.5 * size).clamp_min(0.1) / size)
        window = Window.about(middle, depth_middle, f)
        buffer = self._draw(placed, target, window, _TOOL_REACH)[1]
        rays = window.rays()
        draw_backgrounds(buffer, middle, rays, torch_rng)
        truth, labels, cosine = buffer.images()
        depth = self._measured(placed, truth, cosine, f)
        mask = imperfect(
            labels == point_splatting.TOOL, c.rest_error_share, c.rest_chunk_share, torch_rng
        ) & ~_is_target(labels)
        mask &= target.border.shows(rays)
        points, valid, _ = pick(mask & (depth > 0), depth, rays)
        # Here the rest begins one coarse pixel beside the cut, in an image at the next point: a random gap keeps the
        # network from reading the cut off it.
        wide = torch_rng.uniform(len(points)) < c.rest_gap_share
        start = torch.where(wide, target.cut.radius + torch_rng.uniform(len(points), 0.0, c.rest_gap), 0.0)
        valid &= (points - target.focus[:, None]).norm(dim=-1) > start[:, None]
        other = (torch_rng.uniform(len(points)) < c.wrong_rest_share)[:, None]
        points = torch.where(other[..., None], points.roll(1, 0), points)
        valid = torch.where(other, valid.roll(1, 0), valid)
        return with_rest(cloud, points, valid, torch_rng.generator)

    def _measured(self, placed: Placement, truth: Tensor, cosine: Tensor, f: Tensor) -> Tensor:
        """The sensor's reading of true depths, for some without flying pixels."""
        c, torch_rng = self.config, self._torch_rng
        shininess = self._shininess[placed.item]
        depth = point_splatting.measure(truth, cosine, shininess, f, torch_rng.generator, c.sensor_level)
        return torch.where(cleaned(depth, c.cleaned_share, torch_rng), depth, 0.0)

    def _place(self, B: int) -> Placement:
        """Tools at random poses in the camera frame, uniform on SO(3), most of them in a hand."""
        c, torch_rng = self.config, self._torch_rng
        item_np = self._rng.choice(len(self._weights), B, p=self._weights)
        item = torch.as_tensor(item_np, device=self._device)
        X_ee_tool = self._X_ee_tool[item]
        grasps = random_grasps(self._samples.handle[item_np], self._rng)
        X_tool_hand = torch.as_tensor(grasps, device=self._device)
        f_native = torch.where(torch_rng.uniform(B) < c.kinect_share, 365.5, torch_rng.uniform(B, *c.focal))
        near = torch_rng.uniform(B) < c.near_share
        distance = torch.where(near, torch_rng.uniform(B, c.distance[0], c.near), torch_rng.uniform(B, *c.distance))
        R = torch_rng.rotations(B)
        right, down = c.field
        ray = torch.stack(
            [torch_rng.uniform(B, -right, right), torch_rng.uniform(B, -down, down), torch.ones_like(distance)], -1
        )
        p = ray * distance[:, None]
        X_ee_hand = X_ee_tool @ X_tool_hand
        p_hand = torch.einsum("bij,bj->bi", R, X_ee_hand[:, :3, 3]) + p
        which = torch_rng.integers(0, len(self._hands), B)
        hand = torch.einsum("bij,bnj->bni", R @ X_ee_hand[:, :3, :3], self._hands[which]) + p_hand[:, None]
        has_hand = torch_rng.uniform(B) < c.hand_share
        return Placement(
            item=item,
            R=R,
            p=p,
            ee=torch.einsum("bij,bnj->bni", R, self._ee[item]) + p[:, None],
            normals=torch.einsum("bij,bnj->bni", R, self._normals[item]),
            rest=torch.einsum("bij,bnj->bni", R, self._rest[item]) + p[:, None],
            hand=torch.where(has_hand[:, None, None], hand, hand.new_tensor([0.0, 0.0, -1.0])),
            p_hand=p_hand,
            has_hand=has_hand,
            X_ee_tool=X_ee_tool,
            X_tool_hand=X_tool_hand,
            f_native=f_native,
            distance=distance,
        )

    def _target(self, placed: Placement) -> Target:
        """The EE; or a negative: another category claimed, or the mask on the hand or on another part of the tool."""
        torch_rng, item, p = self._torch_rng, placed.item, placed.p
        B = len(item)
        kind = torch_rng.uniform(B) / max(self.config.negative_share, 1e-9)
        swapped = kind < 0.5
        claimed = torch.where(
            swapped,
            (self._category[item] + torch_rng.integers(1, len(Category), B)) % len(Category),
            self._category[item],
        )
        on_hand = (kind >= 0.5) & (kind < 0.75) & placed.has_hand
        on_rest = (kind >= 0.75) & (kind < 1.0)
        spot = torch_rng.integers(0, placed.rest.shape[1], B)
        batch = torch.arange(B, device=self._device)
        focus = torch.where(on_rest[:, None], placed.rest[batch, spot], p)
        # On the handle only: the other end may be an EE of the same category.
        X_tool_ee = rigid_inverse(placed.X_ee_tool)
        height = (X_tool_ee[:, 2, :3] * self._rest[item, spot]).sum(-1) + X_tool_ee[:, 2, 3]
        on_handle = (height > self._handle[item, 0] + 0.03) & (height < self._handle[item, 1] - 0.03)
        focus = torch.where(on_hand[:, None], placed.hand[batch, spot], focus)
        far_enough = (focus - p).norm(dim=-1) > 0.07
        on_ee = ~(on_hand | on_rest)
        other = torch.einsum("bij,bj->bi", placed.R, self._other_end[item]) + p
        other = torch.where(on_ee[:, None], other, NOWHERE)
        c, radius = self.config, self._radius[claimed]
        return Target(
            focus=focus,
            radius=radius,
            cut=Cut.drawn(focus, radius, other, self._radius[self._other_category[item]], c, torch_rng),
            border=Border.drawn(focus, radius, c.border_share, torch_rng),
            claimed=claimed,
            positive=on_ee & ~swapped,
            admissible=swapped | (on_hand & far_enough) | (on_rest & on_handle),
            on_hand=on_hand,
        )

    def _draw(self, placed: Placement, target: Target, window: Window, reach: int) -> tuple[ZBuffer, ZBuffer]:
        """Z-buffers of the tool alone, and with its hand. reach: of splats without normals [px]."""

        def label(points: Tensor, usual: int, wanted: Tensor, tells: Tensor | None = None) -> Tensor:
            inside = target.cut.holds(points) & wanted[:, None]
            hit = torch.full_like(inside, point_splatting.TARGET, dtype=torch.int32)
            if tells is not None:
                hit = torch.where(tells, point_splatting.TARGET_TELLS_SPIN, hit)
            return torch.where(inside, hit, usual)

        alone = ZBuffer(window)
        tells = self._asymmetric[placed.item]
        alone.draw(placed.ee, label(placed.ee, point_splatting.TOOL, ~target.on_hand, tells), placed.normals, 1)
        alone.draw(placed.rest, label(placed.rest, point_splatting.TOOL, ~target.on_hand), None, reach)
        buffer = alone.copy()
        buffer.draw(placed.hand, label(placed.hand, point_splatting.HAND, target.on_hand), None, reach)
        return alone, buffer


def _is_target(labels: Tensor) -> Tensor:
    return (labels == point_splatting.TARGET) | (labels == point_splatting.TARGET_TELLS_SPIN)
