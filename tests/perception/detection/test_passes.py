"""Passes of the detector over parts of an image: enlarged crops of tools, a coarse look, the crop about the hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.frames import random_rotation, transform
from toolee_robot.perception.detection.detector import TOOL, Detector, RawDetections
from toolee_robot.perception.detection.inputs import DetectorConfig, RgbdBatch, working_size
from toolee_robot.perception.detection.instances import Box, Instance
from toolee_robot.perception.detection.passes import (
    CERTAIN,
    MAGNIFICATION,
    MAX_REDUCTION,
    MIN_MAGNIFICATION,
    MIN_TOOL_SCORE,
    MM_PER_PIXEL,
    Crop,
    coarse_size,
    crop_about,
    crops,
    hand_crop,
    merge,
    merge_coarse,
)
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.types import CameraIntrinsics, HeldRegion, RgbdFrame

IMAGE = (96, 128)
WORKING_PIXELS = 96 * 128


def mask_of(box: Box, image: tuple[int, int] = IMAGE) -> NDArray[np.bool_]:
    mask = np.zeros(image, dtype=np.bool_)
    x0, y0, x1, y1 = (int(v) for v in box)
    mask[y0:y1, x0:x1] = True
    return mask


def instances(*found: tuple[int, float, Box], image: tuple[int, int] = IMAGE) -> list[Instance]:
    """Of (label, score, box); every mask is its box."""
    return [Instance(mask_of(box, image), label, score, box) for label, score, box in found]


@st.composite
def views(draw: st.DrawFn) -> tuple[tuple[int, int], Box]:
    """An image's size and a box inside."""
    height, width = draw(st.integers(1, 1100)), draw(st.integers(1, 2000))
    x = sorted(draw(st.tuples(*[st.floats(0, width)] * 2)))
    y = sorted(draw(st.tuples(*[st.floats(0, height)] * 2)))
    return (height, width), (x[0], y[0], x[1], y[1])


@given(views(), st.integers(2_000, 400_000))
def test_a_crop_shows_the_whole_box_larger_and_never_more_pixels_than_the_first_look(
    view: tuple[tuple[int, int], Box], pixels: int
) -> None:
    image, box = view
    working = working_size(*image, pixels)
    crop = crop_about(box, image, working, pixels)
    if crop is None:
        return
    height, width = crop.size
    assert 0 <= crop.x0 <= box[0] <= box[2] <= crop.x1 <= image[1]
    assert 0 <= crop.y0 <= box[1] <= box[3] <= crop.y1 <= image[0]
    assert crop.holds(box, image)
    assert 0 < height * width <= pixels
    for seen, side, before, whole in (
        (width, crop.x1 - crop.x0, working[1], image[1]),
        (height, crop.y1 - crop.y0, working[0], image[0]),
    ):
        once = side * before / whole  # pixels of the first look
        assert seen <= MAGNIFICATION * once + 1
        assert seen >= MIN_MAGNIFICATION * once - MAGNIFICATION * before / whole - 1.5, "rounded outwards by a pixel"


def test_a_small_tool_gets_the_full_magnification_and_a_large_one_no_second_look() -> None:
    image, working = (424, 512), working_size(424, 512, 640 * 530)
    crop = crop_about((200.0, 150.0, 280.0, 190.0), image, working, 640 * 530)
    assert crop is not None
    first = working[1] / 512
    assert crop.size[1] / (crop.x1 - crop.x0) == pytest.approx(MAGNIFICATION * first, rel=0.01)
    assert crop.size[0] / (crop.y1 - crop.y0) == pytest.approx(MAGNIFICATION * first, rel=0.01)
    assert crop.size[0] * crop.size[1] < 0.25 * working[0] * working[1], "it is cheap"
    assert crop_about((20.0, 20.0, 500.0, 400.0), image, working, 640 * 530) is None


def test_only_tools_without_a_certain_end_effector_are_looked_at_again() -> None:
    left, right = (4.0, 40.0, 44.0, 52.0), (80.0, 40.0, 120.0, 52.0)
    on_left = (34.0, 40.0, 44.0, 52.0)

    def looked_at(*found: tuple[int, float, Box]) -> list[bool]:
        again = crops(instances(*found), IMAGE, IMAGE, WORKING_PIXELS)
        return [any(c.x0 <= b[0] and b[2] <= c.x1 for c in again) for b in (left, right)]

    tools = ((TOOL, 0.9, left), (TOOL, MIN_TOOL_SCORE, right))
    assert looked_at() == [False, False]
    assert looked_at(*tools) == [True, True]
    assert looked_at(*tools, (1, CERTAIN, on_left)) == [False, True]
    assert looked_at(*tools, (1, CERTAIN - 0.01, on_left)) == [True, True]
    assert looked_at(tools[0], (TOOL, MIN_TOOL_SCORE - 0.01, right)) == [True, False]
    assert looked_at((1, 0.2, on_left)) == [False, False], "no tool: nothing says where to look"


WHERE = Crop(20, 20, 100, 80, (96, 128))
boxes_inside = st.tuples(st.integers(0, 108), st.integers(0, 76), st.integers(4, 20), st.integers(4, 20)).map(
    lambda v: (float(v[0]), float(v[1]), float(v[0] + v[2]), float(v[1] + v[3]))
)
found_things = st.lists(st.tuples(st.integers(1, TOOL), st.floats(0.01, 1.0), boxes_inside), max_size=6)


@given(found_things, found_things)
def test_nothing_is_lost_and_nothing_outside_of_the_crops_is_touched(
    first: list[tuple[int, float, Box]], later: list[tuple[int, float, Box]]
) -> None:
    within = [(label, score, box) for label, score, box in later if WHERE.holds(box, IMAGE)]
    merged = merge(instances(*first), [instances(*within)], [WHERE], IMAGE)
    assert [i.label for i in merged[: len(first)]] == [label for label, _, _ in first]
    for i, (label, score, box) in enumerate(first):
        away = box[2] <= WHERE.x0 or box[0] >= WHERE.x1 or box[3] <= WHERE.y0 or box[1] >= WHERE.y1
        if away:
            assert (merged[i].score, merged[i].box) == (score, box)
        assert merged[i].score >= score / 2
        assert label == TOOL or merged[i].box in (box, *(b for _, _, b in within))
    assert all(i.label != TOOL for i in merged[len(first) :])
    assert all(0 < i.score <= 1 and i.mask.any() for i in merged)


class ShortSighted(Detector):
    """Sees red as an EE where it is wide enough, red and grey together as a tool, and notes what it was shown."""

    def __init__(self, least_width: int) -> None:
        super().__init__(
            DetectorConfig(
                widths=(4, 4, 4, 4),
                fpn_channels=16,
                box_features=8,
                mask_layers=1,
                mask_width=8,
                working_pixels=WORKING_PIXELS,
            )
        )
        self.least_width = least_width
        self.looks: list[tuple[int, int]] = []
        self.metres: list[float] = []

    def detect(self, batch: RgbdBatch, *_args: Any, **_kwargs: Any) -> list[RawDetections]:
        self.looks.append((batch.pixels.shape[2], batch.pixels.shape[3]))
        rgb = (batch.pixels[0, :3] * 60 + 110) * (batch.depth[0] > 0)
        red, any_tool = (rgb[0] > 150) & (rgb[1] < 60), rgb[0] > 150
        rows = []
        for seen, label in ((any_tool, TOOL), (red, 1)):
            y, x = torch.nonzero(seen, as_tuple=True)
            if len(x) == 0:
                continue
            box = (float(x.min()), float(y.min()), float(x.max()) + 1, float(y.max()) + 1)
            if label == TOOL or box[2] - box[0] >= self.least_width:
                rows.append((box, label))
            if label == 1:
                self.metres.append((box[2] - box[0]) * float(batch.depth[0][seen].median() / batch.focal[0]))
        boxes = torch.tensor([box for box, _ in rows]).reshape(-1, 4)
        labels = torch.tensor([label for _, label in rows], dtype=torch.long)
        masks = torch.ones((len(rows), 8, 8))
        return [RawDetections(boxes, torch.full((len(rows),), 0.8), labels, masks, boxes)]


def bar(ee: Box = (60.0, 44.0, 70.0, 52.0)) -> RgbdFrame:
    rgb = np.zeros((*IMAGE, 3), np.uint8)
    rgb[46:50, 34:62] = 200
    rgb[mask_of(ee)] = (255, 0, 0)
    return RgbdFrame(rgb, np.full(IMAGE, 0.6, np.float32), CameraIntrinsics(100.0, 100.0, 64.0, 48.0, 128, 96))


def test_an_end_effector_too_small_for_the_first_pass_is_found_at_its_place_by_the_second() -> None:
    detector = ShortSighted(least_width=13)  # it is 10 px wide, in the zoom pass about 16
    found = Segmenter(detector).detect(bar())
    assert [d.category for d in found] == [next(iter(Category))]
    truth = mask_of((60.0, 44.0, 70.0, 52.0))
    assert (found[0].mask & truth).sum() > 0.7 * (found[0].mask | truth).sum()
    np.testing.assert_allclose(found[0].box, (60, 44, 70, 52), atol=1.0)
    assert found[0].score == pytest.approx(0.4)
    assert found[0].tool_mask is not None
    assert found[0].tool_score == pytest.approx(0.8)
    assert len(detector.looks) == 2
    assert detector.looks[1][0] * detector.looks[1][1] <= WORKING_PIXELS
    assert detector.metres[1] == pytest.approx(detector.metres[0], rel=0.1), "the larger picture is of the same size"


def test_a_frame_without_a_tool_costs_one_pass() -> None:
    detector = ShortSighted(least_width=1)
    frame = bar()
    empty = RgbdFrame(np.zeros_like(frame.rgb), frame.depth, frame.intrinsics)
    assert Segmenter(detector).detect(empty) == []
    assert len(detector.looks) == 1


WIDE_EE = (60.0, 40.0, 80.0, 56.0)
NEARLY_WIDE = (61.0, 40.0, 80.0, 56.0)


def scene(focal: float, depth: float = 0.6) -> RgbdFrame:
    """A tool with a red end effector; a pixel is 1000 * depth / focal [mm] wide."""
    rgb = np.zeros((*IMAGE, 3), np.uint8)
    rgb[46:50, 30:62] = 200
    rgb[mask_of(WIDE_EE)] = (255, 0, 0)
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
        (merged,) = merge_coarse(instances((1, fine, WIDE_EE)), instances((1, coarse, NEARLY_WIDE)))
        assert (merged.label, merged.score, merged.box) == (1, 0.7, WIDE_EE)
        np.testing.assert_array_equal(merged.mask, mask_of(WIDE_EE))


def test_an_end_effector_too_large_for_the_first_pass_is_found_at_its_place() -> None:
    detector = LongSighted(most_width=15)  # it is 20 px wide, in the coarse pass 10
    found = Segmenter(detector).detect(scene(focal=1000.0))
    assert [d.score for d in found] == [pytest.approx(0.8)]
    np.testing.assert_allclose(found[0].box, WIDE_EE, atol=2.0)
    assert (found[0].mask & mask_of(WIDE_EE)).sum() > 0.7 * (found[0].mask | mask_of(WIDE_EE)).sum()
    assert found[0].tool_mask is not None


def test_end_effectors_of_a_low_score_are_left_out_and_tools_stay() -> None:
    segmenter = Segmenter(LongSighted(most_width=100, score=0.07))
    assert segmenter.detect(scene(focal=100.0)) == []
    assert [i.label for i in segmenter.instances(scene(focal=100.0))] == [TOOL]
    weak = segmenter.instances(scene(focal=100.0), score_threshold=0.01)
    assert sorted(i.label for i in weak) == [1, TOOL]


CAMERA = CameraIntrinsics(365.5, 380.0, 254.9, 205.4, 512, 424)


@given(
    seed=st.integers(0, 2**31),
    points=hnp.arrays(float, (3, 3), elements=st.floats(-0.2, 0.2)),
    radius=st.floats(0.01, 0.3),
    place=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.3, 1.5)),
)
def test_what_the_camera_sees_of_the_region_is_in_the_crop(
    seed: int, points: np.ndarray, radius: float, place: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(seed)
    X = transform(random_rotation(rng), place)
    crop = hand_crop(X, HeldRegion(points, radius), CAMERA)
    weights = rng.dirichlet(np.ones(len(points)), 300)
    away = rng.normal(size=(300, 3))
    away *= radius * rng.uniform(0.9, 1.0, (300, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    inside = weights @ points @ X[:3, :3].T + X[:3, 3] + away
    inside = inside[inside[:, 2] > 0.01]
    u = CAMERA.fx * inside[:, 0] / inside[:, 2] + CAMERA.cx
    v = CAMERA.fy * inside[:, 1] / inside[:, 2] + CAMERA.cy
    seen = (np.round(u) >= 0) & (np.round(u) < CAMERA.width) & (np.round(v) >= 0) & (np.round(v) < CAMERA.height)
    # Pixel centres are at integer coordinates; half a pixel at the image's border is not worth a look.
    if crop is None:
        assert np.count_nonzero((u > 1) & (u < CAMERA.width - 2) & (v > 1) & (v < CAMERA.height - 2)) == 0
        return
    columns, rows = np.round(u[seen]), np.round(v[seen])
    assert ((columns >= crop.x0) & (columns < crop.x1) & (rows >= crop.y0) & (rows < crop.y1)).all()


@pytest.mark.parametrize("p", [(0.0, 0.0, -0.8), (2.0, 0.0, 0.8), (0.0, -2.0, 0.8)])
def test_a_hand_that_the_camera_does_not_see_has_no_crop(p: tuple[float, float, float]) -> None:
    assert hand_crop(transform(p=p), HeldRegion(np.zeros((1, 3)), 0.1), CAMERA) is None


def test_a_hand_about_the_camera_is_looked_for_everywhere() -> None:
    crop = hand_crop(transform(p=(0.0, 0.0, 0.05)), HeldRegion(np.zeros((1, 3)), 0.1), CAMERA)
    assert crop is not None
    assert (crop.x0, crop.y0, crop.x1, crop.y1) == (0, 0, 512, 424)
