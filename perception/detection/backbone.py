"""The detector's layers: a ResNet-18-like pyramid (FPN, Lin et al. 2017), features of regions, and the mask head.

The mask head takes a region's features together with its colour and metric coordinates. An end effector's mask ends
where the tool leaves a sphere of some centimetres, which a colour image does not show. So the head also sees every
pixel's position in metres relative to the region's centre.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn
from torchvision.models.resnet import BasicBlock
from torchvision.ops import roi_align

from toolee_robot.perception.detection.inputs import CHANNELS, RgbdBatch

_ROI_STRIDES = (4, 8, 16, 32)


class Backbone(nn.Module):
    """ResNet-18 (He et al. 2016) with a narrower last stage, and a feature pyramid at strides 4, 8, 16, 32, 64.

    Args:
        widths: Channels of the four stages.
        channels: Channels of the pyramid.
    """

    def __init__(self, widths: tuple[int, int, int, int], channels: int) -> None:
        super().__init__()
        w, c = widths, channels
        self.stem = nn.Sequential(
            nn.Conv2d(CHANNELS, w[0], 7, 2, 3, bias=False), nn.BatchNorm2d(w[0]), nn.ReLU(), nn.MaxPool2d(3, 2, 1)
        )
        self.stages = nn.ModuleList()
        for i, n in enumerate(w):
            n_in, stride = (w[0], 1) if i == 0 else (w[i - 1], 2)
            shortcut = None
            if stride != 1 or n_in != n:
                shortcut = nn.Sequential(nn.Conv2d(n_in, n, 1, stride, bias=False), nn.BatchNorm2d(n))
            self.stages.append(nn.Sequential(BasicBlock(n_in, n, stride, shortcut), BasicBlock(n, n)))
        self.lateral = nn.ModuleList(_conv_bn(n, c, 1) for n in w)
        self.output = nn.ModuleList(_conv_bn(c, c, 3) for _ in w)

    def forward(self, x: Tensor) -> list[Tensor]:
        """The pyramid's levels (B, C, H_l, W_l), finest first, of pixels x (B, CHANNELS, H, W)."""
        x = self.stem(x)
        stages = []
        for stage in self.stages:
            x = stage(x)
            stages.append(x)
        top = self.lateral[3](stages[3])
        pyramid = [self.output[3](top)]
        for i in (2, 1, 0):
            side = self.lateral[i](stages[i])
            top = side + F.interpolate(top, size=side.shape[-2:], mode="nearest")
            pyramid.insert(0, self.output[i](top))
        pyramid.append(F.max_pool2d(pyramid[-1], 1, 2))
        return pyramid


def pyramid_roi_align(pyramid: list[Tensor], rois: Tensor, size: int) -> Tensor:
    """Features of regions, each from the pyramid level that fits its area (FPN: 224 px at stride 16).

    Args:
        pyramid: Levels at strides 4 to 32.
        rois: Regions (R, 5): image index, box [px].
        size: Cells per side of the result.

    Returns:
        (R, C, size, size).
    """
    side = (rois[:, 3:] - rois[:, 1:3]).clamp(min=1.0).prod(1).sqrt()
    level = (torch.log2(side / 224.0 + 1e-6).floor() + 2).clamp(0, len(pyramid) - 1).long()
    out = pyramid[0].new_zeros((len(rois), pyramid[0].shape[1], size, size), dtype=torch.float32)
    for i, features in enumerate(pyramid):
        index = torch.nonzero(level == i)[:, 0]
        values = roi_align(features.float(), rois[index], size, 1.0 / _ROI_STRIDES[i], 2, aligned=True)
        out = out.index_copy(0, index, values)
    return out


def _conv_bn(n_in: int, n_out: int, size: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(n_in, n_out, size, padding=size // 2, bias=False), nn.BatchNorm2d(n_out))


MASK_SIZE = 56
"""Cells per side of a mask."""
MASK_MARGIN = 1.25
"""Masks cover the detection's box enlarged by this factor, so that parts outside of the box are not lost."""

FEATURES_SIZE = 14
"""Cells per side of the features that `MaskHead` takes."""
_METRES = 0.05
_MAX_DEPTH = 3.0
_NEAR_QUANTILE = 0.3


def mask_boxes(boxes: Tensor) -> Tensor:
    """The boxes that masks cover.

    Args:
        boxes: Boxes of detections, (N, 4).

    Returns:
        Boxes (N, 4) of their masks; they may reach beyond the image.
    """
    centre, half = (boxes[:, :2] + boxes[:, 2:]) / 2, (boxes[:, 2:] - boxes[:, :2]) * (MASK_MARGIN / 2)
    return torch.cat([centre - half, centre + half], 1)


class MaskHead(nn.Module):
    """Predicts masks and their quality (Mask Scoring R-CNN, Huang et al. 2019, without its second network).

    Args:
        channels: Channels of the features.
        layers: Layers at the features' resolution.
        width: Channels at the masks' resolution.
        classes: Number of classes.
    """

    def __init__(self, channels: int, layers: int, width: int, classes: int) -> None:
        super().__init__()
        half = width // 2
        self.detail = nn.Sequential(*_conv(7, half), *_conv(half, half))
        self.descend = nn.Sequential(*_conv(half, width, 2), nn.Conv2d(width, channels, 3, 2, 1))
        context: list[nn.Module] = []
        for _ in range(layers):
            context += [nn.Conv2d(channels, channels, 3, padding=1, bias=False), nn.GroupNorm(16, channels), nn.ReLU()]
        self.context = nn.Sequential(*context)
        self.ascend = nn.ConvTranspose2d(channels, channels, 2, 2)
        self.narrow = nn.Conv2d(channels, width, 1)
        self.fuse = nn.Sequential(*_conv(width + half, width), *_conv(width, width))
        self.refine = _Refinement(width)
        self.output = nn.Conv2d(width, classes, 1)
        self.quality = nn.Sequential(nn.Linear(2 * width, 128), nn.ReLU(), nn.Linear(128, classes))

    def forward(self, features: Tensor, batch: RgbdBatch, rois: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        """Predict masks.

        Args:
            features: Features of the regions, (R, C, 14, 14).
            batch: The images.
            rois: Regions (R, 5): image index, `mask_boxes`.
            labels: Their classes, (R,).

        Returns:
            Logits (R, MASK_SIZE, MASK_SIZE) of the masks, and (R,) of their IoU with the truth.
        """
        detail = self.detail(_near(batch, rois))
        x = self.context(features + self.descend(detail))
        x = F.interpolate(self.narrow(F.relu(self.ascend(x))), (MASK_SIZE, MASK_SIZE), mode="bilinear")
        x = self.refine(self.fuse(torch.cat([x, detail], 1)))
        index = torch.arange(len(rois), device=rois.device)
        logits = self.output(x)[index, labels].float()
        inside = logits.detach().sigmoid()[:, None]
        within = (x * inside).sum((2, 3)) / inside.sum((2, 3)).clamp(min=1.0)
        quality = self.quality(torch.cat([within, x.mean((2, 3))], 1))[index, labels].float()
        return logits, quality


class _Refinement(nn.Module):
    """A residual hourglass of two scales that refines the outlines."""

    def __init__(self, width: int) -> None:
        super().__init__()
        wide = width + width // 2
        self.fine = nn.Sequential(*_conv(width, width))
        self.coarse = nn.Sequential(*_conv(width, wide, 2), *_conv(wide, wide), *_conv(wide, wide))
        self.widen = nn.Conv2d(wide, width, 1)
        self.last = nn.Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)  # type: ignore[arg-type]

    def forward(self, x: Tensor) -> Tensor:
        """Features (R, C, MASK_SIZE, MASK_SIZE), of the same shape."""
        fine = self.fine(x)
        coarse = F.interpolate(self.widen(self.coarse(x)), fine.shape[-2:], mode="bilinear")
        return x + self.last(F.relu(fine + coarse))


def paste_one(patch: NDArray[np.float32], box: NDArray[np.float64], height: int, width: int) -> NDArray[np.bool_]:
    """Resample a mask bilinearly into the image.

    Args:
        patch: Probabilities (S, S).
        box: Box (4,) [px] that they cover; it may reach beyond the image.
        height: Image height [px].
        width: Image width [px].

    Returns:
        Mask (H, W): probability over 0.5 at the pixel centres.
    """
    x0, y0, x1, y1 = (float(v) for v in box)
    mask = np.zeros((height, width), dtype=np.bool_)
    c0, c1 = max(int(np.floor(x0)), 0), min(int(np.ceil(x1)), width)
    r0, r1 = max(int(np.floor(y0)), 0), min(int(np.ceil(y1)), height)
    if c1 <= c0 or r1 <= r0 or x1 - x0 < 0.5 or y1 - y0 < 0.5:
        return mask
    size = patch.shape[0]
    u = (np.arange(c0, c1) + 0.5 - x0) / (x1 - x0) * size - 0.5
    v = (np.arange(r0, r1) + 0.5 - y0) / (y1 - y0) * size - 0.5
    grid_u, grid_v = np.meshgrid(u.astype(np.float32), v.astype(np.float32))
    values = cv2.remap(patch, grid_u, grid_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask[r0:r1, c0:c1] = values > 0.5
    return mask


def _conv(n_in: int, n_out: int, stride: int = 1) -> list[nn.Module]:
    # No normalisation: at this resolution it would cost as much as all the convolutions.
    conv = nn.Conv2d(n_in, n_out, 3, stride, 1)
    nn.init.kaiming_normal_(conv.weight, mode="fan_out", nonlinearity="relu")
    nn.init.zeros_(conv.bias)  # type: ignore[arg-type]
    return [conv, nn.ReLU()]


@torch.no_grad()
def _near(batch: RgbdBatch, rois: Tensor) -> Tensor:
    """Colour and metric coordinates of regions, (R, 7, MASK_SIZE, MASK_SIZE).

    Channels: colour (3); x, y, z from the region's centre and nearer side in units of 5 cm; whether the depth is known.
    The reference in z is a low quantile of the region's depths, because most of a thin tool's box is background.
    """
    colour = roi_align(batch.pixels[:, :3], rois, MASK_SIZE, 1.0, 1, aligned=True)
    image = rois[:, 0].long()
    steps = (torch.arange(MASK_SIZE, device=rois.device) + 0.5) / MASK_SIZE
    u = rois[:, 1, None] + steps * (rois[:, 3] - rois[:, 1])[:, None]
    v = rois[:, 2, None] + steps * (rois[:, 4] - rois[:, 2])[:, None]
    height, width = batch.depth.shape[-2:]
    column, row = u.floor().long().clamp(0, width - 1), v.floor().long().clamp(0, height - 1)
    z = batch.depth[image[:, None, None], row[:, :, None], column[:, None, :]]
    inside = ((u >= 0) & (u < width))[:, None, :] & ((v >= 0) & (v < height))[:, :, None]
    known = inside & (z > 0)
    coarse = torch.where(known, z, torch.inf)[:, 1::4, 1::4].flatten(1).sort(1)[0]
    count = torch.isfinite(coarse).sum(1)
    place = (_NEAR_QUANTILE * count).long()[:, None]
    reference = torch.where(count > 0, coarse.gather(1, place)[:, 0], 0.0)[:, None, None]
    z = torch.where(known, z, reference)
    scale = z / (batch.focal[image][:, None, None] * _METRES)
    x = (u - (rois[:, 1] + rois[:, 3])[:, None] / 2)[:, None, :] * scale
    y = (v - (rois[:, 2] + rois[:, 4])[:, None] / 2)[:, :, None] * scale
    metres = torch.stack([x, y, (z - reference) / _METRES], 1).clamp(-_MAX_DEPTH, _MAX_DEPTH)
    return torch.cat([colour, metres, known[:, None].to(colour.dtype)], 1)
