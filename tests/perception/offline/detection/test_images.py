"""The trainer reads what the data-set generator writes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from tests.errors import raises
from tests.perception.toy_scenes import toy_scenes, write_toys
from toolee_robot.errors import UserError
from toolee_robot.perception.detection.detector import TOOL
from toolee_robot.perception.detection.inputs import STRIDE
from toolee_robot.perception.offline.dataset.records import HEIGHT, WIDTH
from toolee_robot.perception.offline.dataset.scenes import load
from toolee_robot.perception.offline.evaluation.segmentation import true_instances
from toolee_robot.perception.offline.training import images as camera_effects
from toolee_robot.perception.offline.training.backgrounds import Backgrounds, stickers, wear
from toolee_robot.perception.offline.training.detector_training import SegmentationTraining, instances_from_maps
from toolee_robot.perception.offline.training.image_training import SceneStream
from toolee_robot.perception.offline.training.images import DeviceImages, ImageSample, augment


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    depth, camera = np.full((3, HEIGHT, WIDTH), 800, np.uint16), np.tile([365.5, 365.5, 254.9, 205.4], (3, 1))
    toys = replace(toy_scenes(3, height=HEIGHT, width=WIDTH), depth_mm=depth, intrinsics=camera)
    write_toys(tmp_path / "000000", toys)
    return tmp_path


def test_a_data_set_becomes_targets(folder: Path) -> None:
    images = load(folder)
    data = DeviceImages(images, torch.device("cpu"))
    sample = data.sample(3)
    categories = sample.categories
    batch, maps = augment(sample, (HEIGHT, WIDTH), strength=0.0)
    assert batch.pixels.shape[2] % STRIDE == 0
    assert batch.pixels.shape[3] % STRIDE == 0
    torch.testing.assert_close(batch.depth[:, :HEIGHT, :WIDTH], torch.full((3, HEIGHT, WIDTH), 0.8))
    torch.testing.assert_close(batch.focal, torch.full((3,), 365.5))
    instances = instances_from_maps(maps, categories, data.tools)
    for b in range(3):
        labels = sorted(instances.labels[b][instances.labels[b] > 0].tolist())
        assert labels == [int(categories[b, 0]), TOOL]
        for g in torch.nonzero(instances.labels[b])[:, 0].tolist():
            seen = (maps[b, instances.plane[b, g]] == instances.ids[b, g]).numpy()
            rows, columns = np.nonzero(seen)
            box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            assert instances.boxes[b, g].tolist() == box


def test_evaluation_sees_the_same_instances(folder: Path) -> None:
    images = load(folder)
    labels = [label for label, *_ in true_instances(images, 1)]
    assert labels == [int(images.categories[1, 0]), TOOL]
    assert true_instances(images, 1)[0][1].sum() == (images.ee[1] == 1).sum()


@pytest.mark.nightly
def test_ranks_share_a_data_set_without_overlap_while_it_grows(folder: Path) -> None:
    streams = [SceneStream(folder, (rank, 2)) for rank in range(2)]
    try:
        assert [len(images.rgb) for images in streams[0].take(60.0)] == [3]
        assert streams[1].take() == []
        shutil.copytree(folder / "000000", folder / ".000001.part")
        (folder / ".000001.part").rename(folder / "000001")
        assert [len(images.rgb) for images in streams[1].take(60.0)] == [3]
        assert streams[0].take() == []
    finally:
        for stream in streams:
            stream.close()


CPU = torch.device("cpu")


@pytest.fixture
def backgrounds(tmp_path: Path) -> Backgrounds:
    cv2.imwrite(str(tmp_path / "red.png"), np.full((50, 90, 3), (0, 0, 255), np.uint8))
    return Backgrounds(tmp_path, CPU)


def test_a_photograph_is_put_behind_the_tool_and_leaves_it(backgrounds: Backgrounds) -> None:
    torch.manual_seed(1)
    images = torch.full((40, 3, 64, 96), 90.0)
    tool = torch.zeros((40, 64, 96), dtype=torch.bool)
    tool[:, 20:40, 30:60] = True
    made = backgrounds.behind(images, tool, 1.0)
    assert (made[:, :, 21:39, 31:59] == 90).all()
    red = (made[:, 0, 0, 0] > 100).sum()
    assert 5 <= red <= 25  # of 40, a third on average
    assert torch.equal(backgrounds.behind(images, tool, 0.0), images)


def test_a_folder_without_pictures_is_named(tmp_path: Path) -> None:
    with raises(UserError, code="user.backgrounds_empty"):
        Backgrounds(tmp_path, CPU)


@pytest.mark.parametrize("effect", ["tint", "vignette", "expose", "bloom", "motion_blur", "sharpen", "compress"])
def test_a_camera_effect_keeps_shape_and_range(effect: str) -> None:
    torch.manual_seed(0)
    images = torch.rand((3, 3, 45, 61)) * 255
    made = getattr(camera_effects, effect)(images)
    assert made.shape == images.shape
    assert made.min() >= -1e-3
    assert made.max() <= 255 + 1e-3
    assert not torch.equal(made, images)


def test_wide_augmentation_keeps_masks_depth_and_boxes_together(backgrounds: Backgrounds) -> None:
    torch.manual_seed(2)
    n = 24
    rgb = torch.full((n, 64, 96, 3), 60, dtype=torch.uint8)
    maps = torch.zeros((n, 2, 64, 96), dtype=torch.uint8)
    maps[:, 1, 20:44, 30:70] = 1
    maps[:, 0, 20:44, 55:70] = 1
    categories = torch.ones((n, 1), dtype=torch.uint8)
    sample = ImageSample(rgb, torch.full((n, 64, 96), 0.7), torch.full((n,), 80.0), maps, categories)
    batch, made = augment(sample, (64, 96), 1.0, 1.0, backgrounds)
    assert batch.pixels.isfinite().all()
    assert batch.pixels.shape[-2:] == made.shape[-2:] == (64, 96)
    share = (made[:, 1] > 0).float().mean((1, 2)) / (maps[:, 1] > 0).float().mean((1, 2))
    assert share.min() < 0.5
    assert share.max() > 2.5
    assert ((made[:, 0] > 0).sum((1, 2)) > 0).float().mean() > 0.8


def test_backgrounds_without_the_wide_augmentation_are_refused(tmp_path: Path) -> None:
    with raises(UserError, code="user.training_options"):
        SegmentationTraining(tmp_path, tmp_path, backgrounds=tmp_path)
    with raises(UserError, code="user.init_share"):
        SegmentationTraining(tmp_path, tmp_path, init_share=0.5)


COUNT = 60
Effect = Callable[[Tensor, Tensor, float], Tensor]


@pytest.fixture
def backgrounds_of_tool_surfaces(tmp_path: Path) -> Backgrounds:
    noise = np.random.default_rng(0).integers(0, 255, (90, 160, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "noise.png"), noise)
    return Backgrounds(tmp_path, CPU)


@pytest.fixture
def bars() -> tuple[Tensor, Tensor]:
    """Images of two grey bars, tools 1 and 2; the last image shows none."""
    images = torch.full((COUNT, 3, 96, 160), 120.0)
    tool = torch.zeros((COUNT, 96, 160), dtype=torch.uint8)
    tool[:-1, 20:40, 20:140] = 1
    tool[:-1, 60:72, 30:130] = 2
    return images, tool


def effects(backgrounds_of_tool_surfaces: Backgrounds) -> dict[str, Effect]:
    return {
        "stickers": lambda images, tool, strength: stickers(images, tool, strength, backgrounds_of_tool_surfaces),
        "print": stickers,
        "wear": wear,
        "beside": lambda images, tool, strength: backgrounds_of_tool_surfaces.beside(images, tool > 0, strength),
    }


@pytest.mark.parametrize("name", ["stickers", "print", "wear", "beside"])
def test_an_effect_keeps_to_its_side_of_the_outline(
    name: str, backgrounds_of_tool_surfaces: Backgrounds, bars: tuple[Tensor, Tensor]
) -> None:
    torch.manual_seed(0)
    images, tool = bars
    before, ids = images.clone(), tool.clone()
    made = effects(backgrounds_of_tool_surfaces)[name](images, tool, 1.0)
    assert torch.equal(images, before), "the input is left as it was"
    assert torch.equal(tool, ids)
    assert made.isfinite().all()
    assert made.min() >= 0
    assert made.max() <= 255
    changed = (made != images).any(1)
    # A pixel at the outline is shared.
    kept = torch.nn.functional.avg_pool2d((tool > 0)[:, None].float(), 3, 1, 1)[:, 0] > 0.999
    assert not (changed & (kept if name == "beside" else tool == 0)).any()
    share = changed.flatten(1).any(1).float().mean()
    assert 0.15 < share < 0.45, "of all images"


@pytest.mark.parametrize("name", ["stickers", "print", "wear", "beside"])
def test_without_strength_nothing_changes(
    name: str, backgrounds_of_tool_surfaces: Backgrounds, bars: tuple[Tensor, Tensor]
) -> None:
    assert torch.equal(effects(backgrounds_of_tool_surfaces)[name](*bars, 0.0), bars[0])


def test_a_sticker_covers_a_part_of_one_tool(
    backgrounds_of_tool_surfaces: Backgrounds, bars: tuple[Tensor, Tensor]
) -> None:
    torch.manual_seed(1)
    images, tool = bars
    made = stickers(images, tool, 1.0, backgrounds_of_tool_surfaces)
    long = []
    for image, ids in zip((made - images).abs().amax(1) > 0.5, tool, strict=True):
        if image.any():
            assert len(set(ids[image].tolist())) <= 2, "one sticker or two, each on one tool"
            columns = torch.nonzero(image.any(0))[:, 0]
            long.append(int(columns.max() - columns.min()) / 120)
    assert len(long) > 8
    assert 0.1 < float(np.median(long)) < 0.7


@pytest.mark.parametrize("size", [0, 5], ids=["no tool", "a tool between the grid's pixels"])
def test_photographs_lie_anywhere_where_no_tool_is_found(size: int, backgrounds_of_tool_surfaces: Backgrounds) -> None:
    torch.manual_seed(4)
    images = torch.full((300, 3, 96, 128), 120.0)
    tool = torch.zeros((300, 96, 128), dtype=torch.bool)
    tool[:, 81 : 81 + size, 113 : 113 + size] = True
    changed = (backgrounds_of_tool_surfaces.beside(images, tool, 1.0) != images).any(1).float().mean(0)
    assert changed[:24, :32].mean() < changed.mean(), "in a corner no more than elsewhere"


def test_augmented_images_are_the_same_for_the_same_seed_and_keep_labels(
    backgrounds_of_tool_surfaces: Backgrounds,
) -> None:
    n, size = 16, (64, 96)
    maps = torch.zeros((n, 2, *size), dtype=torch.uint8)
    maps[:, 1, 20:44, 30:70] = 1
    maps[:, 0, 20:44, 55:70] = 1
    rgb = torch.randint(0, 255, (n, *size, 3), dtype=torch.uint8)
    categories = torch.ones((n, 1), dtype=torch.uint8)
    sample = ImageSample(rgb, torch.full((n, *size), 0.7), torch.full((n,), 80.0), maps, categories)
    made = []
    for _ in range(2):
        torch.manual_seed(3)
        made.append(augment(sample, size, 1.0, 0.5, backgrounds_of_tool_surfaces))
    assert torch.equal(made[0][0].pixels, made[1][0].pixels)
    assert torch.equal(made[0][1], made[1][1])
    batch, ids = made[0]
    assert batch.pixels.isfinite().all()
    assert int(ids.max()) == 1
    assert not ((ids[:, 0] > 0) & (ids[:, 1] == 0)).any(), "an end effector is part of its tool"
