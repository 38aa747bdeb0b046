"""The mask refiner's network, its losses and its use on masks, without a training."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from tests.errors import raises
from tests.perception.detection.toy_refiner import (
    TINY,
    some_squares,
    training,
    used,
)
from toolee_robot.errors import AssetError, UserError
from toolee_robot.perception.detection.backbone import MASK_SIZE, paste_one
from toolee_robot.perception.detection.instances import mask_iou
from toolee_robot.perception.detection.refiner import (
    Refiner,
    load_refiner,
)
from toolee_robot.perception.offline.training.refiner_training import (
    Detections,
)

pytestmark = pytest.mark.sim(seconds=10)


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> Iterator[None]:
    """Tiny networks: threads cost more than they save, and much more on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


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
