"""Photographs are read, cropped and scored."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.perception.offline.evaluation.photographs import crops, decided, evaluate, read_photographs
from toolee_robot.perception.pipeline import ToolPerception


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    entries = []
    for name, half, ends in (("held", "A", 1), ("empty", "B", 0), ("seen", "training", 0)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((60, 80, 3), 128, np.uint8))
        cv2.imwrite(str(tmp_path / f"{name}-depth.png"), np.full((60, 80), 700, np.uint16))
        end = {"category": "hammer_head", "box": [50, 10, 70, 30], "X_camera_ee": np.eye(4).tolist()}
        entry: dict[str, object] = {
            "name": name,
            "place": name,
            "half": half,
            "depth_is": "measured",
            "rgb": f"{name}.png",
        }
        entry |= {"depth": f"{name}-depth.png", "intrinsics": [70, 70, 40, 30], "ends": [end] * ends, "ignore": []}
        entries.append(entry)
    (tmp_path / "frames.json").write_text(json.dumps({"frames": entries}))
    return tmp_path


def test_a_set_has_depth_in_metres_and_the_frames_of_its_halves_alone(folder: Path) -> None:
    photographs = read_photographs(folder)
    assert [p.name for p in photographs] == ["held", "empty"]
    assert photographs[0].frame.depth.max() == pytest.approx(0.7)
    assert photographs[0].ends[0].category == Category.HAMMER_HEAD


def test_a_crop_holds_its_end_at_twice_the_apparent_size(folder: Path) -> None:
    photograph = read_photographs(folder)[0]
    (crop,) = crops(photograph)
    assert crop.frame.depth.shape == (30, 40)
    assert crop.ends[0].box == (10.0, 5.0, 30.0, 25.0)
    assert crop.frame.intrinsics.fx == photograph.frame.intrinsics.fx


def test_grey_pictures_score_nothing_and_raise_no_usable_alarm(folder: Path) -> None:
    report = evaluate(ToolPerception.load(), read_photographs(folder))
    whole_a, crop_a, whole_b, _ = report["table"]
    assert (whole_a["ends"], whole_a["found"], whole_a["known_poses"], whole_a["right"]) == (1, 0, 1, 0)
    assert (crop_a["ends"], crop_a["known_poses"]) == (1, 0)
    assert (whole_b["empty_frames"], whole_b["frames_with_usable_alarm"]) == (1, 0)


def test_a_folder_without_a_set_is_named(tmp_path: Path) -> None:
    with raises(UserError, code="user.photographs"):
        read_photographs(tmp_path)


def test_an_uncertain_annotation_decides_nothing_near_the_bounds() -> None:
    record = {"annotation_mm": 3.0, "annotation_deg": 3.0}
    assert decided(record, 0.002, np.deg2rad(1.0)) is True
    assert decided(record, 0.018, np.deg2rad(1.0)) is False
    assert decided(record, 0.002, np.deg2rad(5.0)) is False
    assert decided(record, 0.040, np.deg2rad(5.0)) is True, "wrong by its position, however uncertain the rotation"
    assert decided({"annotation_mm": None, "annotation_deg": None}, 0.002, 0.0) is None
