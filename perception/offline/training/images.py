"""The detector's training images: sampled on the device, augmented in whole batches.

Beside the exact warp are the effects of light, cameras and drivers on images (B, 3, H, W) in 0..255: colour casts,
exposure, motion, lost depth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from toolee_robot.perception.detection.inputs import STRIDE, RgbdBatch, encode_rgbd
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet
from toolee_robot.perception.offline.training.backgrounds import Backgrounds, stickers, wear
from toolee_robot.perception.offline.training.image_training import DeviceStore, grown

_BLOCK = 8
"""Width of JPEG's blocks [px]."""
_MOTION = 9
"""Width of the motion kernel [px]."""
_GLOW = 8
"""Width of the cells over which highlights spread [px]."""


def camera_effects(images: Tensor, strength: float) -> Tensor:
    """Vary light, exposure, sharpness, motion blur and compression, each of some images."""
    images = _sometimes(0.25 * strength, images, tint)
    images = _sometimes(0.15 * strength, images, vignette)
    images = _sometimes(0.25 * strength, images, expose)
    images = _sometimes(0.12 * strength, images, bloom)
    images = _sometimes(0.2 * strength, images, motion_blur)
    images = _sometimes(0.2 * strength, images, sharpen)
    return _sometimes(0.3 * strength, images, compress)


def tint(images: Tensor) -> Tensor:
    """Light of a colour, from a warm bulb to a blue sky, with a lamp's green; in half it varies over the image."""
    n, device = len(images), images.device
    warm, green, bright = torch.rand((3, n, 2, 2), device=device) * 2 - 1
    green = green.abs() ** 3 * torch.sign(green + 0.4)
    corners = torch.stack([1 + 0.4 * warm, 1 + 0.22 * green, 1 - 0.45 * warm], 1) * torch.exp(0.35 * bright)[:, None]
    mixed = torch.rand((n, 1, 1, 1), device=device) < 0.5
    corners = torch.where(mixed, corners, corners[:, :, :1, :1])
    light = F.interpolate(corners, images.shape[2:], mode="bilinear", align_corners=True)
    light = light / light.mean((1, 2, 3), keepdim=True)
    return (images * light).clamp(0, 255)


def vignette(images: Tensor) -> Tensor:
    """Darken by up to 80 % towards the corners, about a centre that is not always the image's."""
    n, device = len(images), images.device
    x = torch.linspace(-1, 1, images.shape[3], device=device)[None, None, None, :]
    y = torch.linspace(-1, 1, images.shape[2], device=device)[None, None, :, None]
    across, down = 0.15 * torch.randn((2, n, 1, 1, 1), device=device)
    amount = 0.2 + 0.6 * torch.rand((n, 1, 1, 1), device=device)
    return images * (1 - amount * ((x - across) ** 2 + (y - down) ** 2).clamp(max=2) / 2)


def bloom(images: Tensor) -> Tensor:
    """Clip highlights and let their light spread over what is near."""
    n, device = len(images), images.device
    gain, amount = torch.rand((2, n, 1, 1, 1), device=device)
    bright = images * (1.05 + 0.6 * gain)
    spilt = F.avg_pool2d((bright - 225).clamp(0, 255), _GLOW, ceil_mode=True, count_include_pad=False)
    spilt = F.avg_pool2d(spilt, 5, 1, 2, count_include_pad=False)
    glow = F.interpolate(spilt, images.shape[2:], mode="bilinear", align_corners=False)
    return (bright + glow * (0.3 + 0.9 * amount)).clamp(0, 255)


def expose(images: Tensor) -> Tensor:
    """Underexpose by up to 2.5 stops or overexpose by 1.5, with the grain of a dark picture and clipped highlights.

    Half of the dark pictures are amplified again, with their grain, as a camera's automatic gain does.
    """
    stops = torch.rand((len(images), 1, 1, 1), device=images.device) * 4.0 - 2.5
    under = stops.clamp(max=0).abs()
    lifted, colour = torch.rand((2, *stops.shape), device=images.device)
    grain = torch.randn_like(images) * (2.0 + 2.0 * under)
    # Low light takes the colours first.
    grey = images.mean(1, keepdim=True)
    images = torch.lerp(images, grey, (0.2 * colour * under).clamp(max=0.8))
    gain = torch.exp2(under * (lifted * 2 - 1).clamp(min=0))
    return ((images * torch.exp2(stops) + grain) * gain).clamp(0, 255)


def motion_blur(images: Tensor) -> Tensor:
    """Blur along a straight line of up to 9 px, another one for each image."""
    n, device = len(images), images.device
    angle = torch.rand((n, 1, 1), device=device) * math.pi
    length = torch.rand((n, 1, 1), device=device) * (_MOTION // 2)
    y, x = torch.meshgrid(*[torch.arange(_MOTION, device=device) - _MOTION // 2] * 2, indexing="ij")
    along, across = x * torch.cos(angle) + y * torch.sin(angle), y * torch.cos(angle) - x * torch.sin(angle)
    kernel = (1 - across.abs()).clamp(min=0) * (along.abs() <= length + 0.5)
    kernel = (kernel / kernel.sum((1, 2), keepdim=True)).repeat_interleave(3, 0)[:, None]
    flat = F.pad(images.reshape(1, 3 * n, *images.shape[2:]), (_MOTION // 2,) * 4, mode="replicate")
    return F.conv2d(flat, kernel.to(images.dtype), groups=3 * n).view_as(images)


def sharpen(images: Tensor) -> Tensor:
    """Add up to twice the difference from the blurred image, as small cameras do."""
    amount = torch.rand((len(images), 1, 1, 1), device=images.device) * 2
    soft = F.avg_pool2d(F.pad(images, (1, 1, 1, 1), mode="replicate"), 3, 1)
    return (images + amount * (images - soft)).clamp(0, 255)


def compress(images: Tensor) -> Tensor:
    """Quantise the cosine transform of 8 x 8 blocks, as JPEG does at a low quality; colour at half the resolution."""
    n, _, height, width = images.shape
    padded = F.pad(images, (0, -width % (2 * _BLOCK), 0, -height % (2 * _BLOCK)), mode="replicate")
    grey = padded.mean(1, keepdim=True)
    colour = F.avg_pool2d(padded - grey, 2)
    step = 4 + torch.rand((n, 1, 1, 1), device=images.device) * 20
    k = torch.arange(_BLOCK, device=images.device, dtype=images.dtype)
    basis = torch.cos((k + 0.5) * k[:, None] * math.pi / _BLOCK) * math.sqrt(2 / _BLOCK)
    basis[0] /= math.sqrt(2)
    weights = 1 + 0.5 * (k + k[:, None])

    def quantised(x: Tensor) -> Tensor:
        b, c, h, w = x.shape
        blocks = x.reshape(b, c, h // _BLOCK, _BLOCK, w // _BLOCK, _BLOCK).transpose(3, 4)
        size = step.view(b, 1, 1, 1, 1, 1) * weights
        blocks = torch.round(basis @ blocks @ basis.T / size) * size
        return (basis.T @ blocks @ basis).transpose(3, 4).reshape(b, c, h, w)

    colour = F.interpolate(quantised(colour), scale_factor=2, mode="bilinear", align_corners=False)
    return (quantised(grey) + colour)[..., :height, :width].clamp(0, 255)


def lose_depth(depth: Tensor, tool: Tensor, strength: float) -> Tensor:
    """Lose depth as sensors do: all of it of a few images, ranges of polished tools, and a coarse step.

    Args:
        depth: (B, H, W) [m], 0 where unknown.
        tool: Whether a pixel shows a tool, (B, H, W) bool.
        strength: Strength; 0: none, 1: full.

    Returns:
        The depth, (B, H, W) [m].
    """
    n, device = len(depth), depth.device
    chance = torch.rand((3, n, 1, 1), device=device)
    depth = depth * (chance[0] >= 0.04 * strength)
    # Smooth noise above a level makes connected holes.
    coarse = torch.rand((n, 1, depth.shape[1] // 12 + 1, depth.shape[2] // 12 + 1), device=device)
    smooth = F.interpolate(coarse, depth.shape[1:], mode="bilinear", align_corners=False)[:, 0]
    level = 0.3 + 0.5 * torch.rand((n, 1, 1), device=device)
    holes = tool & (smooth > level) & (chance[1] < 0.2 * strength)
    depth = torch.where(holes, 0.0, depth)
    step = 0.0005 + 0.008 * torch.rand((n, 1, 1), device=device) * depth**2
    return torch.where(chance[2] < 0.2 * strength, torch.round(depth / step.clamp(min=1e-6)) * step, depth)


def _sometimes(share: float, images: Tensor, effect: Callable[[Tensor], Tensor]) -> Tensor:
    """Apply an effect to a share of the images."""
    chosen = torch.rand(len(images), device=images.device) < share
    if not bool(chosen.any()):
        return images
    images = images.clone()
    images[chosen] = effect(images[chosen])
    return images


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
