"""The detector's backbone: a ResNet-18-like feature pyramid (FPN, Lin et al. 2017), and its features of regions."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision.models.resnet import BasicBlock
from torchvision.ops import roi_align

from toolee_robot.perception.detection.inputs import CHANNELS

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
