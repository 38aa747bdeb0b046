"""Training images with photographs behind the tools, a wide range of sizes, and the effects of cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.perception.offline.training import images as camera_effects
from toolee_robot.perception.offline.training.backgrounds import Backgrounds
from toolee_robot.perception.offline.training.detector_training import SegmentationTraining
from toolee_robot.perception.offline.training.images import ImageSample, augment

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


def test_compression_leaves_a_plain_picture_as_it_was() -> None:
    images = torch.full((2, 3, 48, 48), 120.0)
    assert (camera_effects.compress(images) - images).abs().max() < 4


def test_lost_depth_is_lost_on_the_tool_or_everywhere() -> None:
    torch.manual_seed(0)
    depth = torch.full((200, 24, 24), 0.8)
    tool = torch.zeros_like(depth, dtype=torch.bool)
    tool[:, 8:16, 8:16] = True
    made = camera_effects.lose_depth(depth, tool, 1.0)
    whole = (made == 0).all((1, 2))
    assert 1 <= int(whole.sum()) <= 20
    assert (made[~whole][:, 0, 0] > 0.78).all()
    assert ((made[~whole] == 0) & tool[~whole]).any()


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
