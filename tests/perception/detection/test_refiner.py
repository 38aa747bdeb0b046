"""The mask refiner on toy pictures: trained, exported, reloaded, and its effect on detections."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import nn

from tests.errors import raises
from tests.perception.toy_scenes import ArrayImages, enlarged, toy_scenes, write_toys
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.perception.dataset.records import HEIGHT, WIDTH
from toolee_robot.perception.detection.config import DetectorConfig
from toolee_robot.perception.detection.detector import TOOL, Detector
from toolee_robot.perception.detection.detector_weights import load_detector
from toolee_robot.perception.detection.instances import Box, Instances, mask_iou
from toolee_robot.perception.detection.mask_head import MASK_SIZE, paste_one
from toolee_robot.perception.detection.refiner.crops import CELLS, CHANNELS
from toolee_robot.perception.detection.refiner.mask_refinement import MaskRefinement
from toolee_robot.perception.detection.refiner.network import Refiner, RefinerConfig, load_refiner
from toolee_robot.perception.detection.refiner.train import CHECKPOINT, RefinementTraining, losses, train
from toolee_robot.perception.detection.refiner.training_data import (
    MIN_LEARNT_IOU,
    VALIDATION,
    Detections,
    Examples,
    RefinementData,
    is_validation,
    zoom_of,
)
from toolee_robot.perception.detection.segmenter import EVERYTHING, Segmenter
from toolee_robot.perception.detection.train import SegmentationTraining
from toolee_robot.perception.detection.train import train as train_detector
from toolee_robot.perception.detection.zoom_pass import MAGNIFICATION
from toolee_robot.perception.evaluation.segmentation import frame_of
from toolee_robot.perception.weight_files import load_weights, save_weights
from toolee_robot.types import CameraIntrinsics, RgbdFrame

pytestmark = pytest.mark.sim(seconds=30)

CPU = torch.device("cpu")
TIMES = 8
"""A toy's pixel is so many of the data set's wide: the detector sees the former."""
TINY_DETECTOR = DetectorConfig(
    widths=(8, 12, 16, 24),
    fpn_channels=16,
    box_features=32,
    mask_layers=1,
    mask_width=8,
    working_pixels=(HEIGHT // TIMES) * (WIDTH // TIMES),
    pre_nms=50,
    post_nms=20,
)
TINY = RefinerConfig(widths=(8, 12, 16, 24))
STEPS = 150


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
        patch.setattr("toolee_robot.perception.detection.refiner.training_data.VALIDATION", 8)
        yield


def toys(count: int, seed: int = 0) -> ArrayImages:
    """Of the data set's size."""
    return enlarged(toy_scenes(count, seed, HEIGHT // TIMES, WIDTH // TIMES), TIMES)


def training(data: Path, out: Path, detector: Path, **options: object) -> RefinementTraining:
    given = {"batch": 4, "lr": 1e-2, "warmup_steps": 5, "ema": 0.9, "device": "cpu", "model": TINY, **options}
    return RefinementTraining(data, out, detector=detector, **given)  # type: ignore[arg-type]


def described(folder: Path) -> dict[str, object]:
    description: dict[str, object] = json.loads((folder / "refinement.json").read_text())
    return description


@pytest.fixture(scope="module")
def detector(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny detector, trained on eight toy pictures until its masks are rough."""
    out = tmp_path_factory.mktemp("detector")
    pictures = toy_scenes(8, height=HEIGHT // TIMES, width=WIDTH // TIMES)
    options = {"batch": 2, "lr": 5e-3, "warmup_steps": 10, "ema": 0.9, "augmentation": 0.0, "model": TINY_DETECTOR}
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
    return train(training(data, out, detector, max_steps=STEPS, log_every=10))


@pytest.fixture(scope="module")
def refinement_data(detector: Path) -> RefinementData:
    """The detector's detections in the pictures."""
    tensors, description = load_weights(detector, "segmentation")
    network = Detector(TINY_DETECTOR)
    load_detector(network, tensors, description)
    found = RefinementData(network, CPU)
    found.extend(toys(32))
    return found


def masks_of(found: Detections) -> NDArray[np.bool_]:
    """Mask in the image of every detection."""
    row, column = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    return found.mask_at()(column.expand(len(found), -1, -1), row.expand(len(found), -1, -1)).numpy()


def used(refiner: Refiner) -> Refiner:
    """With weights and statistics of batch normalisation other than those it begins with."""
    torch.manual_seed(1)
    for module in refiner.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias, std=0.2)
        if isinstance(module, nn.Linear):
            nn.init.normal_(module.weight, std=0.2)
    refiner.train()
    for _ in range(5):
        refiner(*some_squares(4))
    with torch.inference_mode():
        refiner.eval().output.bias -= refiner(*some_squares(4))[0].mean()
    return refiner


def some_squares(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Squares, categories and scores, at random."""
    squares = torch.cat([255 * torch.rand(count, 3, CELLS, CELLS), torch.randn(count, CHANNELS - 3, CELLS, CELLS)], 1)
    return squares, torch.arange(count) % 4, torch.rand(count)


def test_the_fused_refiner_answers_as_the_trained_one() -> None:
    refiner = used(Refiner(TINY))
    given = some_squares(3)
    with torch.inference_mode():
        logits, quality = refiner(*given)
        fused_logits, fused_quality = refiner.fuse()(*given)
    assert not any(isinstance(module, nn.BatchNorm2d) for module in refiner.modules())
    assert logits.std() > 0.1
    torch.testing.assert_close(fused_logits, logits, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(fused_quality, quality, atol=1e-3, rtol=1e-3)


def test_the_refiner_s_configuration_survives_its_file() -> None:
    config = RefinerConfig((4, 8, 12, 20))
    assert RefinerConfig.from_json(json.loads(json.dumps(config.to_json()))) == config


def test_weights_of_another_refiner_do_not_fit() -> None:
    tensors = Refiner(TINY).state_dict()
    with raises(AssetError, code="asset.architecture"):
        load_refiner(Refiner(replace(TINY, widths=(8, 12, 16, 32))), tensors)
    with raises(AssetError, code="asset.incomplete") as refused:
        load_refiner(Refiner(TINY), {k: v for k, v in tensors.items() if k != "output.bias"})
    assert "output.bias" in str(refused.value)
    with raises(AssetError, code="asset.incomplete") as refused:
        load_refiner(Refiner(TINY), {**tensors, "another": torch.zeros(1)})
    assert "another" in str(refused.value)


def test_a_detection_s_training_mask_is_the_detector_s() -> None:
    """In training as `paste_one` draws it in use."""
    torch.manual_seed(2)
    coarse = nn.functional.pad(torch.rand((3, 1, 5, 5)), (1, 1, 1, 1))
    patches = nn.functional.interpolate(coarse, (MASK_SIZE, MASK_SIZE), mode="bilinear")[:, 0]
    covered = torch.tensor([[10.3, 5.2, 71.8, 60.1], [-20.0, -10.0, 30.5, 47.0], [50.0, 30.0, 110.0, 75.0]])
    one, none = torch.ones(3), torch.zeros(3, dtype=torch.long)
    masks = (patches * 255).round().to(torch.uint8)
    found = Detections(none, covered, covered, masks, none, one, none.byte(), one.bool())
    row, column = torch.meshgrid(torch.arange(64), torch.arange(96), indexing="ij")
    drawn = found.mask_at()(column.expand(3, -1, -1), row.expand(3, -1, -1))
    for patch, box, mask in zip(patches.numpy(), covered.double().numpy(), drawn.numpy(), strict=True):
        pasted = paste_one(patch, box, 64, 96)
        assert pasted.any()
        assert mask_iou(pasted, mask) > 0.99


def test_detections_are_matched_with_end_effectors_of_their_category(refinement_data: RefinementData) -> None:
    assert len(refinement_data) == 32
    assert refinement_data.detections is not None
    pictures, found = toys(8), refinement_data.detections.of(refinement_data.detections.image < 8)
    matched = 0
    for i, mask in enumerate(masks_of(found)):
        image = int(found.image[i])
        right = int(found.category[i]) + 1 == pictures.categories[image, 0]
        iou = mask_iou(mask, pictures.ee[image] > 0) if right else 0.0
        if abs(iou - MIN_LEARNT_IOU) > 0.03:  # cells are coarser than pixels
            assert int(found.truth[i]) == int(iou > MIN_LEARNT_IOU)
            matched += int(found.truth[i])
    assert matched >= 4


def test_both_sizes_are_as_frequent_among_the_pictures_kept_aside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("toolee_robot.perception.detection.refiner.training_data.VALIDATION", VALIDATION)
    pictures = torch.arange(4000)
    for some in (pictures, pictures[is_validation(pictures)]):
        sizes, count = torch.unique(zoom_of(some), return_counts=True)
        assert sizes.tolist() == [1.0, MAGNIFICATION]
        assert count.tolist() == [len(some) // 2] * 2


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


def test_pictures_kept_aside_are_judged_as_in_the_whole_image(refinement_data: RefinementData) -> None:
    assert refinement_data.detections is not None
    pictures, found = toys(32), refinement_data.detections.of(refinement_data.validation)
    assert set(found.image.tolist()) <= {0, 8, 16, 24}
    examples = refinement_data.plain(refinement_data.validation)
    # What is drawn is the hint itself.
    values = losses(20 * examples.squares[:, -1] - 10, torch.zeros(len(found)), examples)
    ious = [mask_iou(m, pictures.ee[i] > 0) for m, i in zip(masks_of(found), found.image.tolist(), strict=True)]
    assert float(values["iou_before"]) == pytest.approx(np.mean(ious), abs=0.05)
    assert values["iou"] == values["iou_before"]


def test_losses_are_of_the_masks_of_true_detections_and_of_the_iou_of_all() -> None:
    """A true detection, a false alarm, and one of an end effector too little visible to count."""
    truth = torch.zeros((3, CELLS, CELLS), dtype=torch.bool)
    truth[0, 20:60, 20:60] = truth[2, :4, :4] = True
    hint, drawn = torch.zeros_like(truth), torch.tensor([True, False, True])
    hint[0, 20:60, 40:80] = True
    squares = torch.zeros((3, CHANNELS, CELLS, CELLS))
    squares[:, -1] = hint.float()
    none = torch.zeros(3, dtype=torch.long)
    examples = Examples(squares, none, none.float(), truth, drawn, torch.tensor([True, True, False]))

    def values(logits: torch.Tensor, expected: list[float]) -> dict[str, float]:
        seen = losses(logits, torch.logit(torch.tensor(expected), 1e-6), examples)
        return {name: float(value) for name, value in seen.items()}

    perfect = torch.where(truth, 20.0, -20.0)
    perfect[1] = 20.0  # whatever is drawn where nothing is
    good = values(perfect, [1.0, 0.0, 0.5])
    assert good == pytest.approx({"mask": 0, "dice": 0, "quality": 0, "iou": 1, "iou_before": 1 / 6}, abs=1e-4)
    assert values(perfect, [1.0, 0.9, 0.5])["quality"] > 0.1, "a false alarm was trusted"
    assert values(perfect, [0.1, 0.0, 0.5])["quality"] > 0.1, "a true detection was not"
    assert values(perfect, [1.0, 0.0, 0.0])["quality"] == good["quality"]
    half = perfect.clone()
    half[0, 40:60] = -20.0
    assert values(half, [0.5, 0.0, 0.5])["iou"] == pytest.approx(0.75)
    assert values(half, [0.5, 0.0, 0.5])["quality"] < values(half, [1.0, 0.0, 0.5])["quality"]
    assert values(half, [1.0, 0.0, 0.5])["mask"] > 0.5


def test_training_writes_weights_configuration_validation_and_log(trained: Path) -> None:
    description = described(trained)
    assert RefinerConfig.from_json(description["model"]) == TINY  # type: ignore[arg-type]
    assert (description["steps"], description["images"]) == (STEPS, 32)
    assert description["training"]["lr"] == 1e-2  # type: ignore[index]
    validation = description["validation"]
    assert validation.keys() == {"mask", "dice", "quality", "iou", "iou_before"}  # type: ignore[attr-defined]
    assert 0 < validation["iou"] <= 1  # type: ignore[index]
    log = description["log"]
    assert [entry["step"] for entry in log] == list(range(10, STEPS + 1, 10))  # type: ignore[attr-defined]
    assert log[-1]["loss"] < 0.8 * log[0]["loss"]  # type: ignore[index]
    load_refiner(Refiner(TINY), load_weights(trained, "refinement")[0])
    assert (trained / CHECKPOINT).is_file()
    assert list((trained / "tensorboard").glob("events*"))


def dilated(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return cv2.dilate(mask.astype(np.uint8), np.ones((33, 33), np.uint8)) > 0


def eroded(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return cv2.erode(mask.astype(np.uint8), np.ones((33, 33), np.uint8)) > 0


def shifted(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.roll(mask, (2 * TIMES, -2 * TIMES), (0, 1))


def box_of(mask: NDArray[np.bool_]) -> Box:
    rows, columns = np.nonzero(mask)
    return float(columns.min()), float(rows.min()), float(columns.max()) + 1, float(rows.max()) + 1


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
        masks, labels, _, boxes = refinement(
            frame_of(pictures, i), ([mask], [int(pictures.categories[i, 0])], [0.5], [box_of(mask)])
        )
        assert (labels, boxes) == ([int(pictures.categories[i, 0])], [box_of(mask)])
        before.append(mask_iou(mask, truth))
        after.append(mask_iou(masks[0], truth))
    assert np.mean(after) > np.mean(before) + 0.05


def by_place(found: Instances, tools: bool) -> dict[tuple[int, Box], tuple[NDArray[np.bool_], float]]:
    """(label, box) -> (mask, score) of the tools, or of the others."""
    return {
        (label, box): (mask, score) for mask, label, score, box in zip(*found, strict=True) if (label == TOOL) == tools
    }


def test_a_refiner_beside_the_detector_changes_end_effectors_only(detector: Path, trained: Path) -> None:
    plain, refined = Segmenter.load(detector, bfloat16=False), Segmenter.load(trained, bfloat16=False)
    pictures = toys(8)
    tools = ends = changed = 0
    for i in range(8):
        frame = frame_of(pictures, i)
        before, after = plain.instances(frame, EVERYTHING), refined.instances(frame, EVERYTHING)
        assert after[2] == sorted(after[2], reverse=True)
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


def test_without_end_effectors_nothing_is_refined(trained: Path) -> None:
    frame = frame_of(toys(1), 0)
    segmenter = Segmenter.load(trained, bfloat16=False)
    assert segmenter.instances(frame, 1.0) == ([], [], [], [])
    refinement = MaskRefinement.load(trained, CPU, bfloat16=False)
    assert refinement is not None
    tool: Instances = ([toys(1).tool[0] > 0], [TOOL], [0.7], [(0.0, 0.0, 9.0, 9.0)])
    masks, *others = refinement(frame, tool)
    assert tuple(others) == tool[1:]
    np.testing.assert_array_equal(masks[0], tool[0][0])


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
    found = refinement(frame_of(pictures, 0), ([left, right], [label] * 2, [0.5, 0.4], [box_of(truth)] * 2))
    assert found[1] == [label]
    assert mask_iou(found[0][0], truth) > mask_iou(left, truth) + 0.1


def noise(unknown: float = 0.0) -> tuple[RgbdFrame, Instances]:
    """An image with holes in its depth, said to be `unknown`, and something found in it."""
    rng = np.random.default_rng(4)
    rgb = rng.integers(0, 255, (60, 80, 3), dtype=np.uint8)
    depth = rng.uniform(0.5, 0.6, (60, 80)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = unknown
    mask = np.zeros(depth.shape, dtype=np.bool_)
    mask[20:41, 12:33] = True
    frame = RgbdFrame(rgb, depth, CameraIntrinsics(200.0, 200.0, 39.5, 29.5, 80, 60))
    return frame, ([mask], [2], [0.5], [(12.0625, 20.0625, 32.9375, 40.9375)])


def test_the_mirrored_image_s_masks_are_the_mirrored_masks() -> None:
    """Of any refiner, though an untrained one draws something else in the mirror: the mean knows no left and right."""
    refinement = MaskRefinement(used(Refiner(TINY)), CPU, bfloat16=False)
    frame, (before, labels, scores, [(x0, y0, x1, y1)]) = noise()
    masks, _, [score], _ = refinement(frame, (before, labels, scores, [(x0, y0, x1, y1)]))
    mirrored = RgbdFrame(frame.rgb[:, ::-1].copy(), frame.depth[:, ::-1].copy(), frame.intrinsics)
    there = ([before[0][:, ::-1].copy()], labels, scores, [(80 - x1, y0, 80 - x0, y1)])
    mirrored_masks, _, [mirrored_score], _ = refinement(mirrored, there)
    assert mirrored_score == pytest.approx(score, abs=1e-3)
    assert 50 < masks[0].sum() < 1400
    assert mask_iou(mirrored_masks[0][:, ::-1], masks[0]) > 0.97
    assert mask_iou(mirrored_masks[0], masks[0]) < 0.9
    assert mask_iou(before[0], masks[0]) < 0.9


@pytest.mark.parametrize("unknown", [np.nan, np.inf])
def test_unknown_depth_is_the_same_as_zero_nan_or_infinity(unknown: float) -> None:
    refinement = MaskRefinement(used(Refiner(TINY)), CPU, bfloat16=False)
    expected, found = refinement(*noise(0.0)), refinement(*noise(unknown))
    assert found[2] == expected[2]
    np.testing.assert_array_equal(found[0][0], expected[0][0])


def test_in_bfloat16_the_masks_are_the_same_but_for_their_borders(trained: Path) -> None:
    pictures = toys(2)
    whole, half = (MaskRefinement.load(trained, CPU, bfloat16=bfloat16) for bfloat16 in (False, True))
    assert whole is not None
    assert half is not None
    for i in range(2):
        mask = dilated(pictures.ee[i] > 0)
        found: Instances = ([mask], [int(pictures.categories[i, 0])], [0.5], [box_of(mask)])
        expected, seen = whole(frame_of(pictures, i), found), half(frame_of(pictures, i), found)
        assert mask_iou(expected[0][0], seen[0][0]) > 0.95
        assert seen[2] == pytest.approx(expected[2], abs=0.05)


def test_without_a_refiner_masks_are_the_detector_s(detector: Path) -> None:
    assert MaskRefinement.load(detector, CPU, bfloat16=False) is None
    tensors, description = load_weights(detector, "segmentation")
    network = Detector(TINY_DETECTOR)
    load_detector(network, tensors, description)
    frame = frame_of(toys(1), 0)
    expected = Segmenter(network, bfloat16=False).instances(frame, EVERYTHING)
    masks, *others = Segmenter.load(detector, bfloat16=False).instances(frame, EVERYTHING)
    assert others == list(expected[1:])
    assert len(masks) > 1
    for mask, before in zip(masks, expected[0], strict=True):
        np.testing.assert_array_equal(mask, before)


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


def test_a_refiner_s_missing_weights_are_named(trained: Path, tmp_path: Path) -> None:
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    (tmp_path / "refinement-00001-of-00001.safetensors").unlink()
    with raises(AssetError, code="asset.missing") as refused:
        Segmenter.load(tmp_path)
    assert "refinement-00001-of-00001.safetensors" in str(refused.value)


def test_a_run_resumes_where_it_stopped(few: Path, detector: Path, trained: Path, tmp_path: Path) -> None:
    shutil.copy(trained / CHECKPOINT, tmp_path)
    # One step more, that changes nothing: what is known is not learnt anew.
    train(training(few, tmp_path, detector, max_steps=STEPS + 1, lr=1e-12, log_every=10))
    log = described(tmp_path)["log"]
    assert [entry["step"] for entry in log] == [*range(10, STEPS + 1, 10), STEPS + 1]  # type: ignore[attr-defined]
    before, after = (torch.load(folder / CHECKPOINT, weights_only=True) for folder in (trained, tmp_path))
    assert after["step"] == STEPS + 1
    assert after["elapsed"] > before["elapsed"]
    for name, _ in Refiner(TINY).named_parameters():
        torch.testing.assert_close(after["model"][name], before["model"][name], atol=1e-6, rtol=0)


def test_a_run_starts_from_exported_weights(few: Path, detector: Path, trained: Path, tmp_path: Path) -> None:
    train(training(few, tmp_path, detector, max_steps=2, lr=1e-12, log_every=1, init=trained))
    first, continued = described(trained)["log"][0], described(tmp_path)["log"][0]  # type: ignore[index]
    assert continued["step"] == 1
    assert continued["loss"] < 0.75 * first["loss"]


def test_a_loss_that_is_not_finite_stops_the_run_and_keeps_what_was_learnt(
    few: Path, detector: Path, trained: Path, tmp_path: Path
) -> None:
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    (tmp_path / "refinement_log.jsonl").unlink()  # goes on with every step, whatever becomes of the run
    kept = {path.name: path.read_bytes() for path in tmp_path.glob("refinement*")}
    assert CHECKPOINT in kept
    with raises(TooleeError, code="toolee.training_diverged") as stopped:
        train(training(few, tmp_path, detector, max_steps=STEPS + 30, lr=1e12, log_every=1))
    assert CHECKPOINT in str(stopped.value)
    (tmp_path / "refinement_log.jsonl").unlink()
    assert {path.name: path.read_bytes() for path in tmp_path.glob("refinement*")} == kept
    assert Segmenter.load(tmp_path).instances(frame_of(toys(1), 0), EVERYTHING)[0]


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"minutes": 0.0}, "user.minutes"),
        ({"batch": 1}, "user.batch"),
        ({"lr": 0.0}, "user.training_options"),
        ({"ema": 1.0}, "user.training_options"),
    ],
)
def test_unusable_settings_are_the_user_s_error(options: dict[str, float], code: str) -> None:
    with raises(UserError, code=code):
        training(Path("data"), Path("out"), Path("detector"), **options)


def without_tools(pictures: ArrayImages, which: slice) -> ArrayImages:
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


def test_a_run_needs_nothing_kept_aside(detector: Path, tmp_path: Path) -> None:
    """Of few pictures, those that are kept for validation may show nothing."""
    write_toys(tmp_path / "000000", without_tools(toys(4), slice(0, 1)))
    out = train(training(tmp_path, tmp_path / "out", detector, max_steps=1))
    assert described(out)["validation"] == {}
    assert MaskRefinement.load(out, CPU, bfloat16=False) is not None


def test_a_damaged_detector_is_named(few: Path, detector: Path, tmp_path: Path) -> None:
    with raises(AssetError, code="asset.missing") as refused:
        train(training(few, tmp_path / "out", tmp_path))
    assert "segmentation.json" in str(refused.value)
    tensors, description = load_weights(detector, "segmentation")
    save_weights(tmp_path, "segmentation", tensors, {k: v for k, v in description.items() if k != "model"})
    with raises(AssetError, code="asset.unreadable"):
        train(training(few, tmp_path / "out", tmp_path))
