"""The detector: its parts against plain definitions, and the whole on toy pictures: trained, exported, reloaded."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torchvision.ops import nms

from tests.errors import raises
from tests.perception.toy_scenes import toy_scenes
from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.boxes import decode, encode, greedy_suppression
from toolee_robot.perception.detection.detector import TOOL, Detector
from toolee_robot.perception.detection.inputs import DetectorConfig
from toolee_robot.perception.detection.instances import Instance, associate, without_duplicates
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.perception.offline.evaluation.segmentation import coco_task, report
from toolee_robot.perception.offline.training.detector_training import SegmentationTraining, train
from toolee_robot.perception.offline.training.images import DeviceImages, _warp

pytestmark = pytest.mark.sim(seconds=30)

TINY = DetectorConfig(
    widths=(16, 24, 32, 48),
    fpn_channels=32,
    box_features=64,
    mask_layers=2,
    mask_width=16,
    working_pixels=64 * 96,
)
PICTURES, STEPS = 2, 60


@pytest.fixture(scope="module", autouse=True)
def _little_work() -> Iterator[None]:
    """Tiny networks: threads cost more than they save. One tool a picture needs few regions to learn from."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("toolee_robot.perception.offline.training.detector_training.ROIS_PER_IMAGE", 24)
        patch.setattr("toolee_robot.perception.offline.training.detector_training.POSITIVE_ROIS", 8)
        yield
    torch.set_num_threads(threads)


def random_boxes(n: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    corner = torch.rand((n, 2), generator=generator) * 80
    return torch.cat([corner, corner + 5 + torch.rand((n, 2), generator=generator) * 40], 1)


def test_boxes_decode_to_what_was_encoded() -> None:
    boxes, anchors = random_boxes(50, 1), random_boxes(50, 2)
    torch.testing.assert_close(decode(encode(boxes, anchors), anchors), boxes, atol=1e-3, rtol=0)


@pytest.mark.parametrize("seed", range(5))
def test_batched_suppression_equals_greedy_suppression(seed: int) -> None:
    boxes = random_boxes(200, seed)
    expected = nms(boxes, torch.arange(200, 0, -1).float(), 0.5)
    keep = greedy_suppression(boxes[None], 0.5, iterations=60)[0]
    assert torch.nonzero(keep)[:, 0].tolist() == sorted(expected.tolist())


def test_augmentation_moves_image_and_maps_together() -> None:
    scenes = toy_scenes(8, seed=3)
    torch.manual_seed(0)
    # The image is the map itself, so after any warp they must still agree where neither was painted over.
    as_image = np.repeat((scenes.tool > 0)[..., None] * np.uint8(255), 3, axis=3)
    depth_mm = np.where(scenes.tool > 0, 600, 900).astype(np.uint16)
    data = DeviceImages(replace(scenes, rgb=as_image, depth_mm=depth_mm), torch.device("cpu"))
    images, depth, scale, warped = _warp(data.sample(8), (80, 120), 1.0)
    tool = warped[:, 1] > 0
    assert tool.sum() > 500
    assert (images[:, 0][tool] > 100).float().mean() > 0.97
    assert (depth[tool] == 0.6).all(), "depth is never a mean of two things"
    assert (depth[~tool] != 0.6).all()
    assert ((scale > 0.74) & (scale < 1.9)).all()


def test_of_two_masks_of_one_thing_the_better_stays() -> None:
    whole, part, other = (np.zeros((20, 40), dtype=bool) for _ in range(3))
    whole[5:10, 5:30], part[5:10, 15:32], other[5:10, 5:30] = True, True, True
    box = (0.0, 0.0, 1.0, 1.0)
    kept = without_duplicates([Instance(part, 1, 0.6, box), Instance(whole, 1, 0.9, box), Instance(other, 2, 0.5, box)])
    assert [(i.label, i.score) for i in kept] == [(1, 0.9), (2, 0.5)], "another class may share pixels"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny detector, overfit on a few toy pictures."""
    out = tmp_path_factory.mktemp("run")
    torch.manual_seed(0)
    config = SegmentationTraining(
        Path("toy"),
        out,
        max_steps=STEPS,
        batch=1,
        lr=4e-3,
        warmup_steps=10,
        ema=0.9,
        augmentation=0,
        model=TINY,
        log_every=1,
    )
    return train(config, toy_scenes(PICTURES))


def log_of(folder: Path) -> list[dict[str, float]]:
    """The losses that a training logged, without its events."""
    entries = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [entry for entry in entries if "event" not in entry]


def test_overfit_detector_finds_the_tools_of_its_pictures(trained: Path) -> None:
    scenes = toy_scenes(PICTURES)
    found = report(coco_task(Segmenter.load(trained), scenes))
    assert found["average"]["AP50"] > 0.8, found
    detections = Segmenter.load(trained).detect(scenes.frame(0))
    best = detections[0]
    assert best.category == list(Category)[int(scenes.categories[0, 0]) - 1]
    truth = scenes.ee[0] > 0
    assert (best.mask & truth).sum() / (best.mask | truth).sum() > 0.6
    assert best.tool_mask is not None
    assert best.tool_mask.sum() > best.mask.sum()


def test_exported_weights_give_the_average_s_output(trained: Path) -> None:
    """What is shipped (half precision, fused) answers as the averaged network of the checkpoint does."""
    state = torch.load(trained / "checkpoint.pt", weights_only=True)
    reference = Detector(TINY)
    reference.load_state_dict(state["average"], strict=False)
    frame = toy_scenes(1, seed=9).frame(0)
    # In float32: in bfloat16 weights that differ by so little may be rounded apart.
    expected = Segmenter(reference, bfloat16=False).detect(frame)
    found = Segmenter.load(trained, bfloat16=False).detect(frame)
    assert [d.category for d in expected] == [d.category for d in found]
    for a, b in zip(expected, found, strict=True):
        assert a.score == pytest.approx(b.score, abs=0.02)
        np.testing.assert_allclose(a.box, b.box, atol=0.5)


def test_a_run_resumes_where_it_stopped(tmp_path: Path) -> None:
    scenes = toy_scenes(4)
    common = {"batch": 2, "warmup_steps": 2, "log_every": 1, "model": TINY, "augmentation": 0.0}
    train(SegmentationTraining(Path("toy"), tmp_path, max_steps=3, **common), scenes)  # type: ignore[arg-type]
    train(SegmentationTraining(Path("toy"), tmp_path, max_steps=5, **common), scenes)  # type: ignore[arg-type]
    log = log_of(tmp_path)
    assert [entry["step"] for entry in log] == [1, 2, 3, 4, 5]


def test_a_run_starts_from_exported_weights(tmp_path: Path, trained: Path) -> None:
    config = SegmentationTraining(
        Path("toy"),
        tmp_path,
        max_steps=2,
        batch=PICTURES,
        lr=1e-6,
        log_every=1,
        model=TINY,
        augmentation=0,
        init=trained,
    )
    train(config, toy_scenes(PICTURES))
    first = log_of(trained)[0]["loss"]
    continued = log_of(tmp_path)[0]["loss"]
    assert continued < 0.75 * first


def test_missing_weights_are_named(tmp_path: Path, trained: Path) -> None:
    with raises(AssetError, code="asset.missing") as refused:
        Segmenter.load(tmp_path)
    assert "segmentation.json" in str(refused.value)
    (tmp_path / "segmentation.json").write_text((trained / "segmentation.json").read_text())
    with raises(AssetError, code="asset.missing") as refused:
        Segmenter.load(tmp_path)
    assert "segmentation-00001-of-00001.safetensors" in str(refused.value)
    (tmp_path / "segmentation-00001-of-00001.safetensors").write_bytes(b"not a tensor file")
    with raises(AssetError, code="asset.unreadable"):
        Segmenter.load(tmp_path)


def test_an_end_effector_belongs_to_the_tool_that_covers_it() -> None:
    left, right, ee = (np.zeros((20, 40), dtype=bool) for _ in range(3))
    left[:, :15], right[:, 20:], ee[5:10, 18:28] = True, True, True
    box = (0.0, 0.0, 1.0, 1.0)
    found = associate([Instance(left, TOOL, 0.9, box), Instance(right, TOOL, 0.9, box), Instance(ee, 1, 0.8, box)])
    assert len(found) == 1
    assert found[0].tool_mask is not None
    assert found[0].tool_mask[0, 30]
    assert not found[0].tool_mask[0, 0]


def test_the_shipped_architecture_fits_its_budget() -> None:
    """All weights together must stay under 40 MB, of which the detector may take 28, stored as half precision."""
    assert 2 * sum(p.numel() for p in Detector().parameters()) < 28e6
