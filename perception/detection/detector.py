"""Mask R-CNN (He et al. 2017) on a ResNet-18-like FPN backbone, trained from scratch, whole batches at a time.

Built from torchvision's blocks and operators. torchvision's own `MaskRCNN` loops over images in Python for anchors,
matching, sampling and resizing, which bounds training by kernel launches; here every step is batched over padded
arrays, so the same weights train several times faster and the inference path stays small.
Boxes are x0, y0, x1, y1 [px] of the network's input; pixel edges are at integer coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torchvision.models.resnet import BasicBlock
from torchvision.ops import batched_nms

from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.backbone import FEATURES_SIZE, Backbone, MaskHead, mask_boxes, pyramid_roi_align
from toolee_robot.perception.detection.boxes import (
    ANCHOR_RATIOS,
    anchor_boxes,
    clip,
    decode,
    greedy_suppression,
    mirror_boxes,
)
from toolee_robot.perception.detection.inputs import DetectorConfig, RgbdBatch, mirror, part_about
from toolee_robot.perception.precision import fold_normalisation
from toolee_robot.perception.weight_files import load_into, load_weights

CLASSES: tuple[str, ...] = ("background", *(c.value for c in Category), "tool")
"""Class names by index; the last one is the whole visible tool."""
TOOL = len(CLASSES) - 1
"""Class index of the whole visible tool."""

MIRROR_MARGIN = 96
"""Surroundings of the detections [px] that the mirrored pass sees; what is farther away hardly changes its answers."""

ROI_DELTA_WEIGHTS = (10.0, 10.0, 5.0, 5.0)
"""Factors on the box head's deltas (Faster R-CNN)."""


@dataclass(frozen=True)
class RawDetections:
    """The N detections of one image, in the network's input.

    Attributes:
        boxes: (N, 4) [px].
        scores: Class probability times the mask's predicted IoU, (N,).
        labels: Class indices, (N,).
        masks: Probabilities, (N, MASK_SIZE, MASK_SIZE), in `mask_boxes`.
        mask_boxes: The boxes that the masks cover, (N, 4) [px].
    """

    boxes: Tensor
    scores: Tensor
    labels: Tensor
    masks: Tensor
    mask_boxes: Tensor


class Detector(nn.Module):
    """Mask R-CNN: backbone, region proposals, box head and mask head.

    Args:
        config: Architecture and inference settings; None: the default.
    """

    def __init__(self, config: DetectorConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or DetectorConfig()
        c, n_anchors, n_classes = config.fpn_channels, 2 * len(ANCHOR_RATIOS), len(CLASSES)
        self.backbone = Backbone(config.widths, c)
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
        """Region proposal outputs per level: objectness (B, A_l) and deltas (B, A_l, 4)."""
        scores, deltas = [], []
        for level in pyramid[1:]:
            x = F.relu(self.rpn_conv(level))
            n = x.shape[0]
            scores.append(self.rpn_score(x).permute(0, 2, 3, 1).reshape(n, -1))
            deltas.append(self.rpn_delta(x).permute(0, 2, 3, 1).reshape(n, -1, 4))
        return scores, deltas

    def anchors(self, height: int, width: int, device: torch.device) -> list[Tensor]:
        """Anchor boxes of an input.

        Args:
            height: Height of the input [px].
            width: Width of the input [px].
            device: torch device of the boxes.

        Returns:
            The anchor boxes of each pyramid level, (A_l, 4) [px].
        """
        return anchor_boxes(self.config.anchor_sizes, height, width, device)

    @torch.no_grad()
    def proposals(
        self, scores: list[Tensor], deltas: list[Tensor], height: int, width: int, pre: int, post: int
    ) -> tuple[Tensor, Tensor]:
        """The best regions after non-maximum suppression.

        Args:
            scores: Objectness per level, (B, A_l).
            deltas: Deltas per level, (B, A_l, 4).
            height: Input height [px].
            width: Input width [px].
            pre: Proposals per level before suppression.
            post: Proposals per image after suppression.

        Returns:
            Boxes (B, post, 4) [px] and which of them are real, (B, post) bool.
        """
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
        """Classify and refine regions of interest.

        Args:
            pyramid: Feature maps, finest level first.
            rois: Regions, (R, 5): index of the image, then x0, y0, x1, y1 [px].

        Returns:
            Class logits (R, C) and, per class, deltas of the box (R, C, 4).
        """
        x = self.box_head(pyramid_roi_align(pyramid[:4], rois, 7))
        return self.box_score(x), self.box_delta(x).unflatten(1, (len(CLASSES), 4))

    def mask_outputs(
        self, pyramid: list[Tensor], batch: RgbdBatch, rois: Tensor, labels: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Masks of regions.

        Args:
            pyramid: The feature pyramid.
            batch: The images.
            rois: Regions (R, 5): image index, box [px].
            labels: Their classes, (R,).

        Returns:
            Mask logits (R, MASK_SIZE, MASK_SIZE) in `mask_boxes` of the regions, and logits (R,) of the masks' IoU.
        """
        rois = torch.cat([rois[:, :1], mask_boxes(rois[:, 1:])], 1)
        features = pyramid_roi_align(pyramid[:4], rois, FEATURES_SIZE)
        masks, quality = self.mask_head(features, batch, rois, labels)
        return masks, quality

    @torch.inference_mode()
    def detect(
        self,
        batch: RgbdBatch,
        score_threshold: float | None = None,
        *,
        mirrored: bool = True,
        labels: Sequence[int] | None = None,
    ) -> list[RawDetections]:
        """Detect instances in each image.

        Args:
            batch: The images.
            score_threshold: Least class probability in the upright image; None: the configured one.
            mirrored: Test-time augmentation: the detections are classified and segmented again in the mirror image of
                the part of the images about all of them; probabilities and logits are the means of both.
            labels: The classes wanted, whose masks alone are computed; None: all.

        Returns:
            The detections of each image.
        """
        threshold = self.config.score_threshold if score_threshold is None else score_threshold
        height, width = size = (batch.pixels.shape[2], batch.pixels.shape[3])
        pyramid = self.backbone(batch.pixels)
        boxes, valid = self.proposals(*self.rpn(pyramid), height, width, self.config.pre_nms, self.config.post_nms)
        rois, scores, found = self._classified(pyramid, boxes, valid, size, threshold)
        if labels is not None:
            wanted = torch.isin(found, torch.tensor(labels, device=found.device))
            rois, scores, found = rois[wanted], scores[wanted], found[wanted]
        masks, quality = self.mask_outputs(pyramid, batch, rois, found)
        if mirrored and len(rois):
            again = self._mirrored_outputs(batch, rois, found)
            scores, masks, quality = ((a + b) / 2 for a, b in zip((scores, masks, quality), again, strict=True))
        scores, masks, covered = scores * quality.sigmoid(), masks.sigmoid(), mask_boxes(rois[:, 1:])
        results = []
        for i in range(len(boxes)):
            here = rois[:, 0] == i
            results.append(RawDetections(rois[here, 1:], scores[here], found[here], masks[here], covered[here]))
        return results

    def _classified(
        self, pyramid: list[Tensor], proposals: Tensor, valid: Tensor, size: tuple[int, int], threshold: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Classify proposals, regress their boxes and suppress duplicates.

        Args:
            pyramid: The feature pyramid.
            proposals: Boxes (B, P, 4) [px].
            valid: Which of them are real, (B, P) bool.
            size: Size (height, width) [px] of the input.
            threshold: Least class probability.

        Returns:
            Regions (N, 5): image index, box [px]; class probabilities (N,); labels (N,).
        """
        image = torch.nonzero(valid)[:, 0]
        proposals = proposals[valid]
        logits, deltas = self.box_outputs(pyramid, torch.cat([image[:, None].to(proposals.dtype), proposals], 1))
        probability = logits.float().softmax(1)[:, 1:]
        roi, label = torch.nonzero(probability > threshold, as_tuple=True)
        score, label = probability[roi, label], label + 1
        box = clip(decode(deltas[roi, label].float(), proposals[roi], ROI_DELTA_WEIGHTS), *size)
        image = image[roi]
        keep = batched_nms(box, score, image * len(CLASSES) + label, self.config.box_nms)
        # At most `max_detections` per image, the best first.
        keep = keep[torch.argsort(image[keep], stable=True)]
        counts = torch.bincount(image[keep], minlength=len(valid))
        rank = torch.arange(len(keep), device=keep.device) - (counts.cumsum(0) - counts)[image[keep]]
        keep = keep[rank < self.config.max_detections]
        return torch.cat([image[keep, None].to(box.dtype), box[keep]], 1), score[keep], label[keep]

    def _mirrored_outputs(self, batch: RgbdBatch, rois: Tensor, labels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Class probabilities and mask and quality logits of rois (R, 5) with `labels` (R,) in the mirrored images.

        Only the part of the images about all rois is seen again: most of the pass is the backbone.
        """
        images, index = torch.unique(rois[:, 0].long(), return_inverse=True)
        part, first = part_about(batch, mask_boxes(rois[:, 1:]), MIRROR_MARGIN)
        mirrored = mirror(part, images)
        pyramid = self.backbone(mirrored.pixels)
        boxes = mirror_boxes(rois[:, 1:] - first.repeat(2), mirrored.pixels.shape[-1])
        rois = torch.cat([index[:, None].to(rois.dtype), boxes], 1)
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


WEIGHTS_NAME = "segmentation"
"""Name of the weight files."""


def load_detector(detector: Detector, tensors: dict[str, Tensor], description: dict[str, Any]) -> None:
    """Load exported weights into a detector.

    Args:
        detector: The network, changed in place.
        tensors: The weights.
        description: Their description, with the class names.

    Raises:
        AssetError: The classes or the architecture differ.
    """
    if list(description.get("classes", [])) != list(CLASSES):
        raise AssetError(f"the detector knows {description.get('classes')}, not {list(CLASSES)}: train it again")
    load_into(detector, tensors, "detector")


def trained_detector(weights_dir: Path | None) -> Detector:
    """Load a trained detector.

    Args:
        weights_dir: Folder of weights; None: the shipped ones.

    Returns:
        The detector.

    Raises:
        AssetError: A file is missing, unreadable or damaged; the message names it.
    """
    tensors, description = load_weights(weights_dir, WEIGHTS_NAME)
    try:
        detector = Detector(DetectorConfig.from_json(description["model"]))
    except (KeyError, TypeError, ValueError) as error:
        raise AssetError(
            f"the detector's description is damaged, fetch it again: {error!r}", code="asset.unreadable"
        ) from error
    load_detector(detector, tensors, description)
    return detector
