"""The detector's training images: sampled on the device, augmented in whole batches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from toolee_robot.perception.detection.inputs import STRIDE, RgbdBatch, encode_rgbd
from toolee_robot.perception.offline.dataset.scene_reader import SegmentationSet
from toolee_robot.perception.offline.training.backgrounds import Backgrounds
from toolee_robot.perception.offline.training.camera_effects import camera_effects, lose_depth
from toolee_robot.perception.offline.training.image_training import DeviceStore, grown
from toolee_robot.perception.offline.training.tool_surfaces import stickers, wear


@dataclass(frozen=True)
class ImageSample:
    """B images on the device.

    Attributes:
        rgb: (B, H, W, 3) uint8.
        depth: (B, H, W) float32 [m], 0 where unknown.
        focal: Focal length, (B,) [px].
        maps: Ids of EE and tool, (B, 2, H, W) uint8.
        categories: Class index of EE ids 1..E, (B, E) uint8.
    """

    rgb: Tensor
    depth: Tensor
    focal: Tensor
    maps: Tensor
    categories: Tensor


class DeviceImages:
    """A data set, or one rank's part of it, as bytes on the device, sampled in shuffled epochs. It may grow.

    Args:
        images: The first images.
        device: torch device that holds them.
        expected: See `DeviceStore`.

    Attributes:
        tools: Largest id of a tool.
    """

    def __init__(self, images: SegmentationSet, device: torch.device, expected: int = 0) -> None:
        self._store = DeviceStore(device, tools=True, expected=expected)
        self._categories = torch.empty((0, 0), dtype=torch.uint8, device=device)
        self.tools = 1
        self._order = torch.empty(0, dtype=torch.long, device=device)
        self.extend(images)

    def __len__(self) -> int:
        return len(self._store)

    def extend(self, more: SegmentationSet) -> None:
        """Add more images; they are sampled from the next epoch on."""
        first = len(self._store)
        self._store.extend(more)
        most = max(self._categories.shape[1], more.categories.shape[1])
        self._categories = grown(self._categories, (len(self._store), most))
        self._categories[first:, : more.categories.shape[1]] = torch.from_numpy(more.categories)
        self.tools = max(self.tools, int(more.tool.max(initial=0)))

    def sample(self, count: int) -> ImageSample:
        """The next `count` images of the epoch."""
        store = self._store
        while len(self._order) < count:
            fresh = torch.randperm(len(store), device=store.device)
            self._order = torch.cat([self._order, fresh])
        index, self._order = self._order[:count], self._order[count:]
        depth = store.depth(index)
        return ImageSample(store.rgb[index], depth, store.focal[index], store.maps[index], self._categories[index])


@torch.no_grad()
def augment(
    sample: ImageSample,
    size: tuple[int, int],
    strength: float = 1.0,
    wide: float = 0.0,
    backgrounds: Backgrounds | None = None,
) -> tuple[RgbdBatch, Tensor]:
    """Augment images and encode them for the network.

    Geometry: mirror, scale 0.74 to 1.9 (as if by another lens: depths are unchanged), shift, roll (any angle for a
    third). Mirrored tools are as good for masks. Colour: gain and offset per channel, contrast, saturation, grey,
    channel order, gamma; blur, noise, occluding rectangles. Depth: the focal length is off by about 1.5 % (standard
    deviation).

    Of a share `wide` of the batches' images the scale is 0.35 to 4 (about a tool where it is large), and all images get
    bright, plain and worn tools, stickers and print on them, photographs behind and beside them, uneven light, and the
    effects of cameras and depth sensors.

    Args:
        sample: The images.
        size: Size (height, width) [px] to which they are resampled, before padding to multiples of STRIDE.
        strength: Strength of the augmentation; 0 only resamples.
        wide: Share of images with the wide range of scales; 0: the first paragraph's augmentation alone.
        backgrounds: Photographs; None: the rendered surroundings stay, and stickers have print alone. Used with `wide`
            alone.

    Returns:
        The network's input and the id maps (B, 2, H', W') uint8.
    """
    n = len(sample.rgb)
    device = sample.rgb.device
    images, depth, scale, maps = _warp(sample, size, strength, wide)
    focal = sample.focal * (size[1] / sample.rgb.shape[2]) * scale
    varied = strength > 0 and wide > 0
    if varied:
        tool = maps[:, 1] > 0
        images = _repaint(images, tool, strength)
        images = wear(images, maps[:, 1], strength)
        images = stickers(images, maps[:, 1], strength, backgrounds)
        if backgrounds is not None:
            images = backgrounds.behind(images, tool, strength)
            images = backgrounds.beside(images, tool, strength)
        depth = lose_depth(depth, tool, strength)
    if strength > 0:
        images = recolour(images, strength)
        if varied:
            images = camera_effects(images, strength)
        images = _blur(images, strength)
        images, depth, maps = _hide(images, depth, maps, strength)
        sigma = torch.rand((n, 1, 1, 1), device=device) ** 2 * 9 * strength
        images = images + torch.randn_like(images) * sigma
        images = images.clamp(0, 255)
        focal = focal * (1 + 0.015 * strength * torch.randn_like(focal))
    pad = (0, -size[1] % STRIDE, 0, -size[0] % STRIDE)
    return encode_rgbd(images, depth, focal), F.pad(maps, pad)


def _uniform(n: int, low: float, high: float, device: torch.device) -> Tensor:
    return torch.rand((n, 1, 1, 1), device=device) * (high - low) + low


def _repaint(images: Tensor, tool: Tensor, strength: float) -> Tensor:
    """Make the tools of a quarter of the images bright or dark, half of them grey: polished, painted and plain ones."""
    n, device = len(images), images.device
    gain = torch.exp(_uniform(n, -0.7, 0.9, device))
    grey = images.mean(1, keepdim=True)
    plain = (torch.rand((n, 1, 1, 1), device=device) < 0.5).to(images.dtype)
    painted = (images + (grey - images) * plain) * gain + _uniform(n, -15, 35, device)
    chosen = torch.rand((n, 1, 1, 1), device=device) < 0.25 * strength
    return torch.where(chosen & tool[:, None], painted.clamp(0, 255), images)


def _middles(tool: Tensor) -> tuple[Tensor, Tensor]:
    """Mean place of the tools' pixels, x and y in -1..1, (B, 2), and whether there are any, (B,)."""
    _, height, width = tool.shape
    x = torch.linspace(-1, 1, width, device=tool.device)
    y = torch.linspace(-1, 1, height, device=tool.device)
    weight = tool.float()
    total = weight.sum((1, 2))
    middle = torch.stack([(weight.sum(1) * x).sum(1), (weight.sum(2) * y).sum(1)], 1) / total.clamp(min=1)[:, None]
    return middle, total > 0


def _warp(
    sample: ImageSample, size: tuple[int, int], strength: float, wide: float = 0.0
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Images (B, 3, H', W'), depth (B, H', W'), magnification (B,) and maps (B, 2, H', W')."""
    images = sample.rgb.permute(0, 3, 1, 2).float()
    n, _, height, width = images.shape
    device = images.device
    scale = torch.exp(_uniform(n, -0.3, 0.64, device).view(n) * strength)
    angle = torch.randn(n, device=device) * 0.08 * strength
    angle = torch.where(
        torch.rand(n, device=device) < 0.33 * strength, torch.rand(n, device=device) * 2 * math.pi, angle
    )
    mirror = torch.where(torch.rand(n, device=device) < 0.5 * strength, -1.0, 1.0)
    shift = (torch.rand((n, 2), device=device) - 0.5) * 0.5 * strength
    if wide > 0:
        widened = torch.rand(n, device=device) < wide
        scale = torch.where(widened, torch.exp(_uniform(n, -1.05, 1.4, device).view(n) * strength), scale)
        middle, seen = _middles(sample.maps[:, 0] > 0)
        close = widened & seen & (scale > 1.5)
        shift = torch.where(close[:, None], middle + 1.4 * shift / scale[:, None], shift)
    cos, sin = torch.cos(angle) / scale, torch.sin(angle) / scale
    aspect = height / width
    # affine_grid's coordinates are normalised by each side: the aspect keeps the rotation rigid.
    theta = torch.stack(
        [
            torch.stack([cos * mirror, -sin * aspect, shift[:, 0]], 1),
            torch.stack([sin * mirror / aspect, cos, shift[:, 1]], 1),
        ],
        1,
    )
    grid = F.affine_grid(theta, [n, 1, *size], align_corners=False)
    warped = F.grid_sample(images, grid, mode="bilinear", padding_mode="reflection", align_corners=False)
    # Reflected copies would be unlabelled tools: their pixels get a plain colour.
    outside = (grid.abs() > 1.0).any(-1)[:, None]
    fill = _uniform(n, 0, 255, device).expand(-1, 3, -1, -1)
    warped = torch.where(outside, fill, warped)
    # Nearest neighbour: interpolated depths between two surfaces belong to neither.
    exact = torch.cat([sample.maps.float(), sample.depth[:, None]], 1)
    exact = F.grid_sample(exact, grid, mode="nearest", padding_mode="zeros", align_corners=False)
    return warped, exact[:, 2], scale, exact[:, :2].to(torch.uint8)


def recolour(images: Tensor, strength: float) -> Tensor:
    """Vary the colours of each image: gains, contrast, saturation, order of the channels and gamma.

    Args:
        images: (B, 3, H, W) in 0..255.
        strength: Strength of the changes; 0: none.

    Returns:
        The images, (B, 3, H, W) in 0..255.
    """
    n, device = len(images), images.device
    grey = images.mean(1, keepdim=True)
    saturation = 1 + _uniform(n, -0.6, 0.6, device) * strength
    saturation = torch.where(torch.rand_like(saturation) < 0.1 * strength, 0.0, saturation)
    images = grey + (images - grey) * saturation
    order = torch.rand((n, 3), device=device).argsort(1)
    shuffled = torch.gather(images, 1, order[:, :, None, None].expand_as(images))
    images = torch.where(torch.rand((n, 1, 1, 1), device=device) < 0.2 * strength, shuffled, images)
    gain = 1 + (torch.rand((n, 3, 1, 1), device=device) - 0.5) * 0.3 * strength
    contrast = torch.exp(_uniform(n, -0.35, 0.35, device) * strength)
    mean = images.mean((1, 2, 3), keepdim=True)
    offset = _uniform(n, -40, 40, device) * strength
    images = ((images - mean) * contrast + mean) * gain + offset
    gamma = torch.exp(_uniform(n, -0.4, 0.4, device) * strength)
    return 255 * (images.clamp(0, 255) / 255 + 1e-6) ** gamma


def _blur(images: Tensor, strength: float) -> Tensor:
    """Blur the first quarter of the batch, whose order is random."""
    count = round(0.25 * strength * len(images))
    if count == 0:
        return images
    device = images.device
    sigma = 0.2 + torch.rand((count, 1), device=device) * strength
    offsets = torch.arange(-3, 4, device=device)
    kernel = torch.exp(-0.5 * (offsets / sigma) ** 2)
    kernel = (kernel / kernel.sum(1, keepdim=True)).repeat_interleave(3, 0)
    flat = images[:count].reshape(1, count * 3, *images.shape[2:])
    flat = F.conv2d(F.pad(flat, (3, 3, 0, 0), mode="replicate"), kernel[:, None, None, :], groups=3 * count)
    flat = F.conv2d(F.pad(flat, (0, 0, 3, 3), mode="replicate"), kernel[:, None, :, None], groups=3 * count)
    return torch.cat([flat.view_as(images[:count]), images[count:]])


def _hide(
    images: Tensor, depth: Tensor, maps: Tensor, strength: float, count: int = 2
) -> tuple[Tensor, Tensor, Tensor]:
    """Put plain rectangles in front of the scene, half of them without depth; what they hide is no target."""
    n, _, height, width = images.shape
    device = images.device
    y = torch.arange(height, device=device)[None, :, None]
    x = torch.arange(width, device=device)[None, None, :]
    for _ in range(count):
        centre = torch.rand((n, 2, 1, 1), device=device) * images.new_tensor([height, width])[None, :, None, None]
        half = (0.01 + torch.rand((n, 2, 1, 1), device=device) ** 2 * 0.1) * height
        inside = ((y - centre[:, 0]).abs() < half[:, 0]) & ((x - centre[:, 1]).abs() < half[:, 1])
        inside = (inside & (torch.rand((n, 1, 1), device=device) < 0.4 * strength))[:, None]
        colour = torch.rand((n, 3, 1, 1), device=device) * 255
        images = torch.where(inside, colour, images)
        maps = torch.where(inside, torch.zeros_like(maps), maps)
        known, share = torch.rand((2, n, 1, 1), device=device)
        depth = torch.where(inside[:, 0], depth * (0.5 + 0.5 * share) * (known < 0.5), depth)
    return images, depth, maps
