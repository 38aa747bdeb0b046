"""Mask R-CNN (He et al. 2017) on a ResNet-18-like FPN backbone, trained from scratch, whole batches at a time.

Built from torchvision's blocks and operators. torchvision's own `MaskRCNN` loops over images in Python for anchors,
matching, sampling and resizing, which bounds training by kernel launches; here every step is batched over padded
arrays, so the same weights train several times faster and the inference path stays small.
Boxes are x0, y0, x1, y1 [px] of the network's input; pixel edges are at integer coordinates.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torchvision.models.resnet import BasicBlock
from torchvision.ops import batched_nms, roi_align

from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.boxes import (
    ANCHOR_RATIOS,
    anchor_boxes,
    clip,
    decode,
    greedy_suppression,
    mirror_boxes,
)
from toolee_robot.perception.detection.inputs import CHANNELS, RgbdBatch, mirror
from toolee_robot.perception.detection.mask_head import MaskHead, features_size, mask_boxes
from toolee_robot.perception.precision import fold_normalisation
from toolee_robot.perception.weight_files import load_into, load_weights

CLASSES: tuple[str, ...] = ("background", *(c.value for c in Category), "tool")
"""Class index -> name. Index 5 is the whole visible tool."""
TOOL = len(CLASSES) - 1
WEIGHTS_NAME = "segmentation"
MAX_ENLARGEMENT = 2.0

_ROI_STRIDES = (4, 8, 16, 32)
ROI_DELTA_WEIGHTS = (10.0, 10.0, 5.0, 5.0)


@dataclass(frozen=True)
class DetectorConfig:
    """Architecture and inference settings; stored beside the weights.

    anchor_sizes: square root of the anchors' areas [px], two a pyramid level (strides 8 to 64).
    working_pixels: images are scaled to about this area, up by at most MAX_ENLARGEMENT: an EE a metre away is
    20 px wide in a depth camera's image, few for a pyramid that begins at stride 4. pre_nms a level, post_nms an image.
    score_threshold: doubtful detections are given, too; whether a pose is usable is decided by `trust.py`.
    """

    widths: tuple[int, int, int, int] = (64, 128, 256, 384)
    fpn_channels: int = 128
    box_features: int = 512
    mask_layers: int = 4
    mask_width: int = 64
    anchor_sizes: tuple[tuple[float, float], ...] = ((16, 26), (40, 64), (100, 160), (230, 350))
    working_pixels: int = 640 * 530
    pre_nms: int = 200
    post_nms: int = 60
    rpn_nms: float = 0.7
    score_threshold: float = 0.08
    box_nms: float = 0.5
    max_detections: int = 12

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> DetectorConfig:
        sizes = tuple((float(a), float(b)) for a, b in data["anchor_sizes"])
        return cls(**{**data, "widths": tuple(data["widths"]), "anchor_sizes": sizes})


@dataclass(frozen=True)
class RawDetections:
    """One image's N detections. boxes (N, 4), labels (N,); scores (N,): probability of the class times the IoU that
    the mask is expected to have; masks (N, MASK_SIZE, MASK_SIZE): probabilities in `mask_boxes` (N, 4)."""

    boxes: Tensor
    scores: Tensor
    labels: Tensor
    masks: Tensor
    mask_boxes: Tensor


class Backbone(nn.Module):
    """ResNet-18 with a narrower last stage, and a feature pyramid at strides 4, 8, 16, 32, 64."""

    def __init__(self, config: DetectorConfig) -> None:
        super().__init__()
        w, c = config.widths, config.fpn_channels
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


class Detector(nn.Module):
    """Backbone, region proposals, box head and mask head."""

    def __init__(self, config: DetectorConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or DetectorConfig()
        c, n_anchors, n_classes = config.fpn_channels, 2 * len(ANCHOR_RATIOS), len(CLASSES)
        self.backbone = Backbone(config)
        self.rpn_conv = nn.Conv2d(c, c, 3, padding=1)
        self.rpn_score = nn.Conv2d(c, n_anchors, 1)
        self.rpn_delta = nn.Conv2d(c, 4 * n_anchors, 1)
        self.box_head = nn.Sequential(
            nn.Flatten(),
            nn.Linear(c * 49, config.box_features),
            nn.LayerNorm(config.box_features),
            nn.ReLU(),
            nn.Linear(config.box_features, config.box_features),
            nn.LayerNorm(config.box_features),
            nn.ReLU(),
        )
        self.box_score = nn.Linear(config.box_features, n_classes)
        self.box_delta = nn.Linear(config.box_features, 4 * n_classes)
        self.mask_head = MaskHead(c, config.mask_layers, config.mask_width, n_classes)
        for layer in (self.rpn_conv, self.rpn_score, self.rpn_delta, self.box_score, self.box_delta):
            nn.init.normal_(layer.weight, std=0.001 if layer is self.box_delta else 0.01)
            assert layer.bias is not None
            nn.init.zeros_(layer.bias)
        for module in self.modules():
            if isinstance(module, nn.Conv2d) and module.bias is None:
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def rpn(self, pyramid: list[Tensor]) -> tuple[list[Tensor], list[Tensor]]:
        """Per level: objectness (B, A_l) and deltas (B, A_l, 4)."""
        scores, deltas = [], []
        for level in pyramid[1:]:
            x = F.relu(self.rpn_conv(level))
            n = x.shape[0]
            scores.append(self.rpn_score(x).permute(0, 2, 3, 1).reshape(n, -1))
            deltas.append(self.rpn_delta(x).permute(0, 2, 3, 1).reshape(n, -1, 4))
        return scores, deltas

    def anchors(self, height: int, width: int, device: torch.device) -> list[Tensor]:
        """Per level: anchor boxes (A_l, 4) of an input of this size."""
        return anchor_boxes(self.config.anchor_sizes, height, width, device)

    @torch.no_grad()
    def proposals(
        self, scores: list[Tensor], deltas: list[Tensor], height: int, width: int, pre: int, post: int
    ) -> tuple[Tensor, Tensor]:
        """The best regions after suppression: boxes (B, post, 4) and which of them are real (B, post) bool."""
        level_scores, level_boxes = [], []
        for s, d, a in zip(scores, deltas, self.anchors(height, width, scores[0].device), strict=True):
            top, index = s.float().topk(min(pre, s.shape[1]), dim=1)
            level_scores.append(top)
            level_boxes.append(decode(torch.gather(d.float(), 1, index[..., None].expand(-1, -1, 4)), a[index]))
        score, boxes = torch.cat(level_scores, 1), clip(torch.cat(level_boxes, 1), height, width)
        large = ((boxes[..., 2:] - boxes[..., :2]) >= 2.0).all(-1)
        score = torch.where(large, score, -torch.inf)
        score, order = score.sort(dim=1, descending=True)
        boxes = torch.gather(boxes, 1, order[..., None].expand(-1, -1, 4))
        keep = greedy_suppression(boxes, self.config.rpn_nms) & torch.isfinite(score)
        chosen = torch.where(keep, score, -torch.inf).topk(min(post, score.shape[1]), dim=1)
        return torch.gather(boxes, 1, chosen.indices[..., None].expand(-1, -1, 4)), torch.isfinite(chosen.values)

    def box_outputs(self, pyramid: list[Tensor], rois: Tensor) -> tuple[Tensor, Tensor]:
        """Class logits (R, C) and deltas (R, C, 4) of rois (R, 5): image index, box."""
        x = self.box_head(pyramid_roi_align(pyramid[:4], rois, 7))
        return self.box_score(x), self.box_delta(x).unflatten(1, (len(CLASSES), 4))

    def mask_outputs(
        self, pyramid: list[Tensor], batch: RgbdBatch, rois: Tensor, labels: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Mask logits (R, MASK_SIZE, MASK_SIZE) in `mask_boxes` of rois (R, 5), and logits (R,) of the masks' IoU."""
        rois = torch.cat([rois[:, :1], mask_boxes(rois[:, 1:])], 1)
        features = pyramid_roi_align(pyramid[:4], rois, features_size())
        masks, quality = self.mask_head(features, batch, rois, labels)
        return masks, quality

    @torch.inference_mode()
    def detect(self, batch: RgbdBatch, score_threshold: float | None = None) -> list[RawDetections]:
        """Detections of each image, of which the class is at first at least as probable as the threshold (None:
        configured).

        What is found is judged and drawn again in the mirrored image: probabilities and logits are the means of both.
        """
        threshold = self.config.score_threshold if score_threshold is None else score_threshold
        height, width = size = (batch.pixels.shape[2], batch.pixels.shape[3])
        pyramid = self.backbone(batch.pixels)
        boxes, valid = self.proposals(*self.rpn(pyramid), height, width, self.config.pre_nms, self.config.post_nms)
        rois, scores, labels = self._found(pyramid, boxes, valid, size, threshold)
        masks, quality = self.mask_outputs(pyramid, batch, rois, labels)
        if len(rois):
            again = self._mirrored_outputs(batch, rois, labels)
            scores, masks, quality = ((a + b) / 2 for a, b in zip((scores, masks, quality), again, strict=True))
        scores, masks, covered = scores * quality.sigmoid(), masks.sigmoid(), mask_boxes(rois[:, 1:])
        results = []
        for i in range(len(boxes)):
            here = rois[:, 0] == i
            results.append(RawDetections(rois[here, 1:], scores[here], labels[here], masks[here], covered[here]))
        return results

    def _found(
        self, pyramid: list[Tensor], proposals: Tensor, valid: Tensor, size: tuple[int, int], threshold: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What is in the proposals (B, P, 4), where `valid` (B, P), of images of `size` (height, width), each thing
        once: rois (N, 5), probabilities (N,) and labels (N,) of their classes."""
        image = torch.nonzero(valid)[:, 0]
        proposals = proposals[valid]
        logits, deltas = self.box_outputs(pyramid, torch.cat([image[:, None].to(proposals.dtype), proposals], 1))
        probability = logits.float().softmax(1)[:, 1:]
        roi, label = torch.nonzero(probability > threshold, as_tuple=True)
        score, label = probability[roi, label], label + 1
        box = clip(decode(deltas[roi, label].float(), proposals[roi], ROI_DELTA_WEIGHTS), *size)
        image = image[roi]
        keep = batched_nms(box, score, image * len(CLASSES) + label, self.config.box_nms)
        # Each image by itself, its best first.
        keep = keep[torch.argsort(image[keep], stable=True)]
        counts = torch.bincount(image[keep], minlength=len(valid))
        rank = torch.arange(len(keep), device=keep.device) - (counts.cumsum(0) - counts)[image[keep]]
        keep = keep[rank < self.config.max_detections]
        return torch.cat([image[keep, None].to(box.dtype), box[keep]], 1), score[keep], label[keep]

    def _mirrored_outputs(self, batch: RgbdBatch, rois: Tensor, labels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of rois (R, 5), as the mirrored images show them: the probabilities (R,) of the classes `labels` (R,), mask
        logits (R, MASK_SIZE, MASK_SIZE), the right way round again, and logits (R,) of the masks' IoU."""
        images, index = torch.unique(rois[:, 0].long(), return_inverse=True)
        mirrored = mirror(batch, images)
        pyramid = self.backbone(mirrored.pixels)
        rois = torch.cat([index[:, None].to(rois.dtype), mirror_boxes(rois[:, 1:], batch.pixels.shape[-1])], 1)
        probability = self.box_outputs(pyramid, rois)[0].float().softmax(1)
        masks, quality = self.mask_outputs(pyramid, mirrored, rois, labels)
        return probability.gather(1, labels[:, None])[:, 0], masks.flip(2), quality

    def fuse(self) -> Detector:
        """Fold batch normalisation into the convolutions, in place, for inference only."""
        self.eval()
        for module in list(self.modules()):
            if isinstance(module, BasicBlock):
                module.conv1, module.bn1 = fuse_conv_bn_eval(module.conv1, module.bn1), nn.Identity()
                module.conv2, module.bn2 = fuse_conv_bn_eval(module.conv2, module.bn2), nn.Identity()
        fold_normalisation(self)
        return self


def working_size(height: int, width: int, pixels: int) -> tuple[int, int]:
    """Height and width, of an area of about `pixels`, at which the network sees an image of the given size."""
    factor = min(MAX_ENLARGEMENT, math.sqrt(pixels / (height * width)))
    return max(1, round(height * factor)), max(1, round(width * factor))


def load_detector(detector: Detector, tensors: dict[str, Tensor], description: dict[str, Any]) -> None:
    """Put weights that a training run exported into `detector`. Raises AssetError if they do not fit."""
    if list(description.get("classes", [])) != list(CLASSES):
        raise AssetError(
            f"the detector knows {description.get('classes')}, not {list(CLASSES)}: train it again",
            code="asset.classes",
        )
    load_into(detector, tensors, "detector")


def trained_detector(weights_dir: Path | None) -> Detector:
    """The shipped detector, or the one a training run left in `weights_dir`. Raises AssetError naming the file that is
    missing, unreadable or damaged."""
    tensors, description = load_weights(weights_dir, WEIGHTS_NAME)
    try:
        detector = Detector(DetectorConfig.from_json(description["model"]))
    except (KeyError, TypeError, ValueError) as error:
        raise AssetError(
            f"the detector's description is damaged, fetch it again: {error!r}", code="asset.unreadable"
        ) from error
    load_detector(detector, tensors, description)
    return detector


def pyramid_roi_align(pyramid: list[Tensor], rois: Tensor, size: int) -> Tensor:
    """Features (R, C, size, size) of rois (R, 5), each from the level that fits its area (FPN, 224 px -> stride 16)."""
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
