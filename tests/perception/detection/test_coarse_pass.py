"""The coarse pass: when a scene is seen again at a coarser scale, and how its detections join the others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.perception.detection.test_zoom_pass import IMAGE, ShortSighted, instances, mask_of
from toolee_robot.perception.detection.detector import TOOL, RawDetections
from toolee_robot.perception.detection.inputs import RgbdBatch
from toolee_robot.perception.detection.passes import MAX_REDUCTION, MM_PER_PIXEL, coarse_size, merge_coarse
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.types import CameraIntrinsics, RgbdFrame

EE = (60.0, 40.0, 80.0, 56.0)
NEARLY = (61.0, 40.0, 80.0, 56.0)
AWAY = (10.0, 10.0, 30.0, 30.0)


def scene(focal: float, depth: float = 0.6) -> RgbdFrame:
    """A tool with a red end effector; a pixel is 1000 * depth / focal [mm] wide."""
    rgb = np.zeros((*IMAGE, 3), np.uint8)
    rgb[46:50, 30:62] = 200
    rgb[mask_of(EE)] = (255, 0, 0)
    intrinsics = CameraIntrinsics(focal, focal, 64.0, 48.0, IMAGE[1], IMAGE[0])
    return RgbdFrame(rgb, np.full(IMAGE, depth, np.float32), intrinsics)


class LongSighted(ShortSighted):
    """Does not know an end effector that is too wide in the network's input."""

    def __init__(self, most_width: float, score: float = 0.8) -> None:
        super().__init__(least_width=1)
        self.most_width, self.score = most_width, score

    def detect(self, batch: RgbdBatch, *_args: Any, **_kwargs: Any) -> list[RawDetections]:
        raw = super().detect(batch)[0]
        known = (raw.labels == TOOL) | (raw.boxes[:, 2] - raw.boxes[:, 0] <= self.most_width)
        scores = raw.scores[known].where(raw.labels[known] == TOOL, raw.scores.new_tensor(self.score))
        return [RawDetections(raw.boxes[known], scores, raw.labels[known], raw.masks[known], raw.mask_boxes[known])]


@pytest.mark.parametrize("working", [(96, 128), (192, 256)])
def test_the_scale_is_that_of_the_scene_whatever_the_working_size(working: tuple[int, int]) -> None:
    frame = scene(focal=1500.0)  # 0.4 mm a pixel
    size = coarse_size(frame, working)
    assert size is not None
    assert 0.4 * IMAGE[0] / size[0] == pytest.approx(MM_PER_PIXEL, rel=0.02)
    assert 0.4 * IMAGE[1] / size[1] == pytest.approx(MM_PER_PIXEL, rel=0.02)


def test_a_scene_that_is_nearly_as_coarse_or_without_depth_is_not_seen_again() -> None:
    just = 1000 * 0.6 / (MM_PER_PIXEL * MAX_REDUCTION)
    assert coarse_size(scene(just * 0.99), IMAGE) is None
    assert coarse_size(scene(just * 1.01), IMAGE) is not None
    assert coarse_size(scene(1500.0, depth=0.0), IMAGE) is None
    half = scene(1500.0)
    half.depth[:, :60] = np.nan
    assert coarse_size(half, IMAGE) == coarse_size(scene(1500.0), IMAGE)


def test_a_thing_of_both_passes_keeps_its_fine_mask_and_the_better_score() -> None:
    for fine, coarse in ((0.3, 0.7), (0.7, 0.3)):
        (merged,) = merge_coarse(instances((1, fine, EE)), instances((1, coarse, NEARLY)))
        assert (merged.label, merged.score, merged.box) == (1, 0.7, EE)
        np.testing.assert_array_equal(merged.mask, mask_of(EE))


def test_things_of_one_pass_stay() -> None:
    merged = merge_coarse(instances((1, 0.4, EE)), instances((1, 0.6, AWAY), (2, 0.5, NEARLY)))
    assert sorted((i.label, i.score) for i in merged) == [(1, 0.4), (1, 0.6), (2, 0.5)]


def test_an_end_effector_too_large_for_the_first_pass_is_found_at_its_place() -> None:
    detector = LongSighted(most_width=15)  # it is 20 px wide, in the coarse pass 10
    found = Segmenter(detector).detect(scene(focal=1000.0))
    assert [d.score for d in found] == [pytest.approx(0.8)]
    np.testing.assert_allclose(found[0].box, EE, atol=2.0)
    assert (found[0].mask & mask_of(EE)).sum() > 0.7 * (found[0].mask | mask_of(EE)).sum()
    assert found[0].tool_mask is not None


def test_far_from_the_camera_there_is_no_coarse_pass() -> None:
    detector = LongSighted(most_width=100)
    segmenter = Segmenter(detector)
    segmenter.detect(scene(focal=100.0))
    looks = len(detector.looks)
    segmenter.detect(scene(focal=1000.0))
    assert len(detector.looks) == 2 * looks + 1


def test_end_effectors_of_a_low_score_are_left_out_and_tools_stay() -> None:
    segmenter = Segmenter(LongSighted(most_width=100, score=0.07))
    assert segmenter.detect(scene(focal=100.0)) == []
    assert [i.label for i in segmenter.instances(scene(focal=100.0))] == [TOOL]
    weak = segmenter.instances(scene(focal=100.0), score_threshold=0.01)
    assert sorted(i.label for i in weak) == [1, TOOL]


def test_the_size_of_the_image_alone_does_not_matter() -> None:
    frame = scene(focal=1500.0)
    K = replace(frame.intrinsics, fx=3000.0, fy=3000.0, cx=128.0, cy=96.0, width=256, height=192)
    large = RgbdFrame(frame.rgb.repeat(2, 0).repeat(2, 1), frame.depth.repeat(2, 0).repeat(2, 1), K)
    assert coarse_size(large, IMAGE) == coarse_size(frame, IMAGE)
