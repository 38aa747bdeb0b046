"""Stickers, print, wear, and photographs beside tools: where they are, and what they leave alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from toolee_robot.perception.offline.training.backgrounds import Backgrounds, Patches, stickers, wear
from toolee_robot.perception.offline.training.images import ImageSample, augment

CPU = torch.device("cpu")
COUNT = 60
Effect = Callable[[Tensor, Tensor, float], Tensor]


@pytest.fixture
def backgrounds(tmp_path: Path) -> Backgrounds:
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


def effects(backgrounds: Backgrounds) -> dict[str, Effect]:
    return {
        "stickers": lambda images, tool, strength: stickers(images, tool, strength, backgrounds),
        "print": stickers,
        "wear": wear,
        "beside": lambda images, tool, strength: backgrounds.beside(images, tool > 0, strength),
    }


@pytest.mark.parametrize("name", ["stickers", "print", "wear", "beside"])
def test_an_effect_keeps_to_its_side_of_the_outline(
    name: str, backgrounds: Backgrounds, bars: tuple[Tensor, Tensor]
) -> None:
    torch.manual_seed(0)
    images, tool = bars
    before, ids = images.clone(), tool.clone()
    made = effects(backgrounds)[name](images, tool, 1.0)
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
def test_without_strength_nothing_changes(name: str, backgrounds: Backgrounds, bars: tuple[Tensor, Tensor]) -> None:
    assert torch.equal(effects(backgrounds)[name](*bars, 0.0), bars[0])


def test_a_sticker_covers_a_part_of_one_tool(backgrounds: Backgrounds, bars: tuple[Tensor, Tensor]) -> None:
    torch.manual_seed(1)
    images, tool = bars
    made = stickers(images, tool, 1.0, backgrounds)
    long = []
    for image, ids in zip((made - images).abs().amax(1) > 0.5, tool, strict=True):
        if image.any():
            assert len(set(ids[image].tolist())) <= 2, "one sticker or two, each on one tool"
            columns = torch.nonzero(image.any(0))[:, 0]
            long.append(int(columns.max() - columns.min()) / 120)
    assert len(long) > 8
    assert 0.1 < float(np.median(long)) < 0.7


def test_the_middle_of_a_narrow_patch_is_opaque() -> None:
    torch.manual_seed(2)
    n = 200
    half = torch.tensor([30.0, 2.5]).repeat(n, 1)
    patches = Patches.random(torch.tensor([48.0, 32.0]).repeat(n, 1), half, torch.zeros(n), (64, 96))
    assert (patches.cover[:, 32, 48] > 0.999).all()
    assert (patches.cover[:, 0] == 0).all()


@pytest.mark.parametrize("size", [0, 5], ids=["no tool", "a tool between the grid's pixels"])
def test_photographs_lie_anywhere_where_no_tool_is_found(size: int, backgrounds: Backgrounds) -> None:
    torch.manual_seed(4)
    images = torch.full((300, 3, 96, 128), 120.0)
    tool = torch.zeros((300, 96, 128), dtype=torch.bool)
    tool[:, 81 : 81 + size, 113 : 113 + size] = True
    changed = (backgrounds.beside(images, tool, 1.0) != images).any(1).float().mean(0)
    assert changed[:24, :32].mean() < changed.mean(), "in a corner no more than elsewhere"


def test_augmented_images_are_the_same_for_the_same_seed_and_keep_labels(backgrounds: Backgrounds) -> None:
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
        made.append(augment(sample, size, 1.0, 0.5, backgrounds))
    assert torch.equal(made[0][0].pixels, made[1][0].pixels)
    assert torch.equal(made[0][1], made[1][1])
    batch, ids = made[0]
    assert batch.pixels.isfinite().all()
    assert int(ids.max()) == 1
    assert not ((ids[:, 0] > 0) & (ids[:, 1] == 0)).any(), "an end effector is part of its tool"
