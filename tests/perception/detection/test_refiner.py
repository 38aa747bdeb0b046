"""The mask refiner on toy pictures: trained, exported, reloaded, and its effect on detections."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from tests.errors import raises
from tests.perception.detection.toy_refiner import (
    CPU,
    TIMES,
    TINY_DETECTOR,
    box_of,
    dilated,
    eroded,
    masks_of,
    shifted,
    toys,
    training,
)
from tests.perception.toy_scenes import toy_scenes, write_toys
from toolee_robot.errors import AssetError, UserError
from toolee_robot.perception.detection.detector import TOOL, Detector, load_detector
from toolee_robot.perception.detection.instances import Box, Instance, mask_iou
from toolee_robot.perception.detection.refiner import MaskRefinement, Squares
from toolee_robot.perception.detection.segmenter import EVERYTHING, Segmenter
from toolee_robot.perception.offline.dataset.records import HEIGHT, WIDTH
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet
from toolee_robot.perception.offline.training.detector_training import SegmentationTraining
from toolee_robot.perception.offline.training.detector_training import train as train_detector
from toolee_robot.perception.offline.training.refiner_training import (
    MIN_LEARNT_IOU,
    RefinementData,
    train,
)
from toolee_robot.perception.weight_files import load_weights, save_weights

pytestmark = [pytest.mark.sim(seconds=30), pytest.mark.nightly]

STEPS = 120


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> Iterator[None]:
    """Tiny networks: threads cost more than they save, and much more on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module", autouse=True)
def _more_kept_aside() -> Iterator[None]:
    """Every eighth picture: of so few as there are here, every fiftieth is one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("toolee_robot.perception.offline.training.refiner_training.VALIDATION", 8)
        yield


@pytest.fixture(scope="module")
def detector(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny detector, trained on four toy pictures until its masks are rough."""
    out = tmp_path_factory.mktemp("detector")
    pictures = toy_scenes(4, height=HEIGHT // TIMES, width=WIDTH // TIMES)
    options = {"batch": 1, "lr": 5e-3, "warmup_steps": 10, "ema": 0.9, "augmentation": 0.0, "model": TINY_DETECTOR}
    with pytest.MonkeyPatch.context() as patch:  # one tool a picture needs few regions to learn from
        patch.setattr("toolee_robot.perception.offline.training.detector_training.ROIS_PER_IMAGE", 24)
        patch.setattr("toolee_robot.perception.offline.training.detector_training.POSITIVE_ROIS", 8)
        return train_detector(SegmentationTraining(Path("toy"), out, max_steps=60, **options), pictures)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same pictures and more, as a data set's."""
    folder = tmp_path_factory.mktemp("data")
    write_toys(folder / "000000", toys(32))
    return folder


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first of them."""
    folder = tmp_path_factory.mktemp("few")
    write_toys(folder / "000000", toys(4))
    return folder


@pytest.fixture(scope="module")
def trained(detector: Path, data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The detector with its refiner beside it."""
    out = tmp_path_factory.mktemp("both")
    shutil.copytree(detector, out, dirs_exist_ok=True)
    return train(training(data, out, detector, max_steps=STEPS, batch=2, log_every=10))


@pytest.fixture(scope="module")
def refinement_data(detector: Path) -> RefinementData:
    """The detector's detections in the pictures."""
    tensors, description = load_weights(detector, "segmentation")
    network = Detector(TINY_DETECTOR)
    load_detector(network, tensors, description)
    found = RefinementData(network, CPU)
    found.extend(toys(32))
    return found


def test_detections_are_matched_with_end_effectors_of_their_category(refinement_data: RefinementData) -> None:
    assert len(refinement_data) == 32
    assert refinement_data.detections is not None
    pictures, found = toys(8), refinement_data.detections.of(refinement_data.detections.image < 8)
    matched = 0
    squares = Squares.about(found.boxes).boxes()  # what lies outside of them does not count
    for i, mask in enumerate(masks_of(found)):
        image = int(found.image[i])
        right = int(found.category[i]) + 1 == pictures.categories[image, 0]
        x0, y0, x1, y1 = (max(round(float(side)), 0) for side in squares[i])
        seen = np.s_[y0:y1, x0:x1]
        iou = mask_iou(mask[seen], pictures.ee[image][seen] > 0) if right else 0.0
        if abs(iou - MIN_LEARNT_IOU) > 0.03:  # cells are coarser than pixels
            assert int(found.truth[i]) == int(iou > MIN_LEARNT_IOU)
            matched += int(found.truth[i])
    assert matched >= 4


def test_examples_show_their_end_effector(refinement_data: RefinementData) -> None:
    """What the squares hold and what is to be learnt there lie in the same place, however a square is varied."""
    torch.manual_seed(3)
    assert refinement_data.ready
    examples = refinement_data.batch(64)
    assert examples.learnt.sum() == 48
    assert torch.isfinite(examples.squares).all()
    assert not examples.truth[~examples.learnt].any()
    drawn, truth = examples.squares[examples.learnt], examples.truth[examples.learnt]
    assert truth.flatten(1).any(1).all()
    known = drawn[:, 6] > 0
    # The bar with its end lies 30 cm before everything else.
    assert (drawn[:, 5][truth & known].abs() < 0.1).float().mean() > 0.99
    colour = drawn[:, :3].flatten(2)
    end, others = (truth & known).flatten(1)[:, None], ((drawn[:, 5] > 2.9) & known).flatten(1)[:, None]
    apart = (colour * end).sum(2) / end.sum(2) - (colour * others).sum(2) / others.sum(2)
    spread = ((colour - (colour * end).sum(2, keepdim=True) / end.sum(2, keepdim=True)) * end).abs().sum(2) / end.sum(2)
    assert (apart.abs().amax(1) > 2 * spread.amin(1)).float().mean() > 0.8


@pytest.mark.parametrize("spoilt", [dilated, eroded, shifted])
def test_spoilt_masks_of_new_pictures_are_better_refined(
    trained: Path, spoilt: Callable[[NDArray[np.bool_]], NDArray[np.bool_]]
) -> None:
    refinement = MaskRefinement.load(trained, CPU, bfloat16=False)
    assert refinement is not None
    pictures = toys(8, seed=7)
    before, after = [], []
    for i in range(8):
        truth = pictures.ee[i] > 0
        mask = spoilt(truth)
        found = Instance(mask, int(pictures.categories[i, 0]), 0.5, box_of(mask))
        (refined,) = refinement(pictures.frame(i), [found])
        assert (refined.label, refined.box) == (found.label, found.box)
        before.append(mask_iou(mask, truth))
        after.append(mask_iou(refined.mask, truth))
    assert np.mean(after) > np.mean(before) + 0.05


def by_place(found: list[Instance], tools: bool) -> dict[tuple[int, Box], tuple[NDArray[np.bool_], float]]:
    """(label, box) -> (mask, score) of the tools, or of the others."""
    return {(i.label, i.box): (i.mask, i.score) for i in found if (i.label == TOOL) == tools}


def test_a_refiner_beside_the_detector_changes_end_effectors_only(detector: Path, trained: Path) -> None:
    plain, refined = Segmenter.load(detector, bfloat16=False), Segmenter.load(trained, bfloat16=False)
    pictures = toys(8)
    tools = ends = changed = 0
    for i in range(8):
        frame = pictures.frame(i)
        before, after = plain.instances(frame, EVERYTHING), refined.instances(frame, EVERYTHING)
        assert [i.score for i in after] == sorted((i.score for i in after), reverse=True)
        expected, found = by_place(before, tools=True), by_place(after, tools=True)
        assert found.keys() == expected.keys()
        for place, (mask, score) in found.items():
            np.testing.assert_array_equal(mask, expected[place][0])
            assert score == expected[place][1]
        tools += len(found)
        expected, found = by_place(before, tools=False), by_place(after, tools=False)
        assert found.keys() <= expected.keys(), "nothing new, though one thing that was drawn twice may now be one"
        assert all(mask.any() and 0 <= score <= 1 for mask, score in found.values())
        ends += len(found)
        changed += sum(score != expected[place][1] for place, (_, score) in found.items())
    assert tools >= 8
    assert changed == ends >= 8


def test_one_end_effector_segmented_twice_is_one(trained: Path) -> None:
    """Two detections that shared too little to be the same thing, until both are drawn where it is."""
    refinement = MaskRefinement.load(trained, CPU, bfloat16=False)
    assert refinement is not None
    pictures = toys(1)
    truth = pictures.ee[0] > 0
    x0, _, x1, _ = box_of(truth)
    left, right = truth.copy(), truth.copy()
    left[:, round(x0 + 0.55 * (x1 - x0)) :], right[:, : round(x0 + 0.45 * (x1 - x0))] = False, False
    label = int(pictures.categories[0, 0])
    box = box_of(truth)
    (found,) = refinement(pictures.frame(0), [Instance(left, label, 0.5, box), Instance(right, label, 0.4, box)])
    assert found.label == label
    assert mask_iou(found.mask, truth) > mask_iou(left, truth) + 0.1


def test_without_a_refiner_masks_are_the_detector_s(detector: Path) -> None:
    assert MaskRefinement.load(detector, CPU, bfloat16=False) is None
    tensors, description = load_weights(detector, "segmentation")
    network = Detector(TINY_DETECTOR)
    load_detector(network, tensors, description)
    frame = toys(1).frame(0)
    expected = Segmenter(network, bfloat16=False).instances(frame, EVERYTHING)
    found = Segmenter.load(detector, bfloat16=False).instances(frame, EVERYTHING)
    assert [i[1:] for i in found] == [i[1:] for i in expected]
    assert len(found) > 1
    for one, before in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.mask, before.mask)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("{", "asset.unreadable"),
        ("[]", "asset.unreadable"),
        ("{}", "asset.unreadable"),
        ('{"model": {"widths": [8, 12, 16, 24], "depth": 3}}', "asset.unreadable"),
        ('{"model": {"widths": 8}}', "asset.unreadable"),
        ('{"model": {"widths": [8, 12, 16, 32]}}', "asset.architecture"),
    ],
)
def test_a_damaged_refiner_is_named(text: str, code: str, trained: Path, tmp_path: Path) -> None:
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    (tmp_path / "refinement.json").write_text(text)
    with raises(AssetError, code=code):
        Segmenter.load(tmp_path)


def without_tools(pictures: SegmentationSet, which: slice) -> SegmentationSet:
    """Some of the pictures blank."""
    blank = replace(pictures, rgb=pictures.rgb.copy(), ee=pictures.ee.copy(), tool=pictures.tool.copy())
    blank.rgb[which], blank.ee[which], blank.tool[which] = 60, 0, 0
    return replace(blank, depth_mm=np.where(blank.tool > 0, 600, 900).astype(np.uint16))


def test_data_that_show_no_end_effector_are_the_user_s_error(detector: Path, tmp_path: Path) -> None:
    write_toys(tmp_path / "000000", without_tools(toys(2), slice(None)))
    with raises(UserError, code="user.data_empty"):
        train(training(tmp_path, tmp_path / "out", detector, max_steps=1, patience=3.0))
    with raises(UserError, code="user.data_empty"):
        train(training(tmp_path / "nothing", tmp_path / "out", detector, max_steps=1, patience=0.1))


def test_a_damaged_detector_is_named(few: Path, detector: Path, tmp_path: Path) -> None:
    with raises(AssetError, code="asset.missing") as refused:
        train(training(few, tmp_path / "out", tmp_path))
    assert "segmentation.json" in str(refused.value)
    tensors, description = load_weights(detector, "segmentation")
    save_weights(tmp_path, "segmentation", tensors, {k: v for k, v in description.items() if k != "model"})
    with raises(AssetError, code="asset.unreadable"):
        train(training(few, tmp_path / "out", tmp_path))
