"""The mirrored pass: detections are classified and segmented again in the mirror image, and only then is it
computed.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from tests.perception.detection.test_detector import TINY
from toolee_robot.perception.detection import detector as detector_module
from toolee_robot.perception.detection.boxes import mirror_boxes
from toolee_robot.perception.detection.detector import Detector, RawDetections
from toolee_robot.perception.detection.inputs import RgbdBatch, encode_rgbd

HEIGHT, WIDTH = 64, 96
BOXES = torch.tensor([[10.0, 4.0, 34.0, 20.0], [50.0, 24.0, 59.5, 31.0], [0.0, 40.0, 96.0, 64.0]])
NOTHING = torch.zeros((3, 4))


class Untrained(Detector):
    """Random weights."""

    def __init__(self, boxes: Tensor) -> None:
        torch.manual_seed(0)
        super().__init__(replace(TINY, score_threshold=0.0, max_detections=100))
        nn.init.zeros_(self.box_delta.weight)
        # As they begin, all classes are as probable wherever one looks.
        nn.init.normal_(self.box_score.weight)
        self.boxes = boxes
        self.passes: list[int] = []
        self.backbone.register_forward_hook(lambda _, inputs, __: self.passes.append(len(inputs[0])))
        self.eval()

    def proposals(self, *_: object) -> tuple[Tensor, Tensor]:
        return self.boxes, self.boxes[..., 2] > self.boxes[..., 0]


def images(count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Colour (B, 3, H, W), depth (B, H, W) with holes [m], and focal length (B,) [px]: noise at two scales."""
    generator = torch.Generator().manual_seed(1)
    coarse = torch.rand((count, 4, HEIGHT // 8, WIDTH // 8), generator=generator)
    noise = coarse.repeat_interleave(8, 2).repeat_interleave(8, 3)
    noise = (noise + torch.rand((count, 4, HEIGHT, WIDTH), generator=generator)) / 2
    depth = 0.5 + 0.4 * noise[:, 3]
    return 255 * noise[:, :3], depth * (noise[:, 3] > 0.2), torch.tensor([80.0, 100.0, 120.0][:count])


def in_order(found: RawDetections) -> RawDetections:
    """By class, then from top to bottom: scores that nearly agree have no order."""
    order = (found.labels * 1000 + found.boxes[:, 1]).argsort()
    return RawDetections(*(v[order] for v in (found.boxes, found.scores, found.labels, found.masks, found.mask_boxes)))


def assert_same(found: RawDetections, expected: RawDetections) -> None:
    for name in ("boxes", "scores", "labels", "masks", "mask_boxes"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), atol=1e-4, rtol=0, msg=name)


def test_the_mirrored_image_s_detections_are_the_mirrored_detections() -> None:
    """Of any network, though an untrained one draws something else in the mirror: the mean knows no left and right."""
    rgb, depth, focal = images(1)
    batch, mirrored = encode_rgbd(rgb, depth, focal), encode_rgbd(rgb.flip(3), depth.flip(2), focal)
    found = in_order(Untrained(BOXES[None]).detect(batch)[0])
    there = in_order(Untrained(mirror_boxes(BOXES, WIDTH)[None]).detect(mirrored)[0])
    assert len(found.boxes) == 15
    assert found.masks.std() > 0.05, "masks of one value would be of no use here"
    assert found.scores.std() > 0.05
    expected = RawDetections(
        mirror_boxes(there.boxes, WIDTH),
        there.scores,
        there.labels,
        there.masks.flip(2),
        mirror_boxes(there.mask_boxes, WIDTH),
    )
    assert_same(found, expected)


def test_a_batch_s_images_are_detected_as_if_alone() -> None:
    rgb, depth, focal = images(3)
    boxes = torch.stack([BOXES, NOTHING, BOXES / 2])
    detector = Untrained(boxes)
    together = detector.detect(encode_rgbd(rgb, depth, focal))
    assert [len(found.boxes) for found in together] == [15, 0, 15]
    assert detector.passes == [3, 2], "the one without anything found has no mirrored pass"
    for i, found in enumerate(together):
        part = slice(i, i + 1)
        alone = Untrained(boxes[part]).detect(encode_rgbd(rgb[part], depth[part], focal[part]))[0]
        assert_same(in_order(found), in_order(alone))


def wide_images() -> RgbdBatch:
    """Noise, (1, 6, 448, 576)."""
    generator = torch.Generator().manual_seed(2)
    rgb, depth = torch.rand((1, 3, 448, 576), generator=generator), torch.rand((1, 448, 576), generator=generator)
    return encode_rgbd(255 * rgb, 0.5 + 0.4 * depth, torch.tensor([400.0]))


def test_the_mirrored_pass_sees_the_surroundings_of_the_detections_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """And says of them what it does with the whole image: another place in the image would be another mask."""
    batch, boxes = wide_images(), torch.tensor([[[260.0, 200.0, 280.0, 230.0], [300.0, 190.0, 330.0, 250.0]]])
    sizes: list[tuple[int, ...]] = []
    detector = Untrained(boxes)
    detector.backbone.register_forward_hook(lambda _, inputs, __: sizes.append(tuple(inputs[0].shape[2:])))
    found = in_order(detector.detect(batch)[0])
    monkeypatch.setattr(detector_module, "MIRROR_MARGIN", 576)
    whole = in_order(detector.detect(batch)[0])
    assert sizes == [(448, 576), (320, 288), (448, 576), (448, 576)]
    assert whole.scores.std() > 0.1
    assert whole.masks.std() > 0.03
    torch.testing.assert_close(found.scores, whole.scores, atol=0.002, rtol=0)
    torch.testing.assert_close(found.masks, whole.masks, atol=0.006, rtol=0)
