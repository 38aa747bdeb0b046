"""The metrics against values computed by hand, and against the symmetry groups."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from tests.examples import examples
from toolee_robot.cli.app import run
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.evaluation.photographs import crops, decided, evaluate, read_photographs
from toolee_robot.perception.offline.evaluation.report import table1
from toolee_robot.perception.pipeline import ToolPerception

CUBE = 0.02 * (np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), -1).reshape(-1, 3) - 0.5)
seeds = st.integers(0, 10_000)
categories = st.sampled_from(list(Category))


def random_pose(seed: int, distance: float = 0.6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return transform(Rotation.random(rng=rng), np.array([0, 0, distance]) + rng.uniform(-0.1, 0.1, 3))


@given(seeds, categories, st.integers(0, 63))
@examples(40)
def test_a_member_of_the_group_is_no_error(seed: int, category: Category, number: int) -> None:
    X = random_pose(seed)
    elements = category.symmetry.elements()
    turned = X @ transform(elements[number % len(elements)])
    assert category.symmetry.rotation_error(turned[:3, :3], X[:3, :3]) < 1e-6
    low, high = CUBE.min(0), CUBE.max(0)
    assert metrics.box_iou(turned, X, low, high, category.symmetry) > 0.99


@given(seeds, categories, st.floats(0.001, 0.2))
@examples(30)
def test_a_shift_leaves_a_known_overlap(seed: int, category: Category, shift: float) -> None:
    X = random_pose(seed)
    along = X @ transform(p=(0.0, 0.0, shift))
    overlap = max(0.02 - shift, 0.0) / 0.02
    expected = overlap / (2 - overlap)
    found = metrics.box_iou(along, X, CUBE.min(0), CUBE.max(0), category.symmetry)
    assert found == pytest.approx(expected, abs=0.1)  # a grid of ten points along a side


@given(seeds, categories, st.integers(0, 63), st.floats(0.0, 1.0))
@examples(50)
def test_an_axis_s_error_is_that_of_the_nearest_of_like_poses(
    seed: int, category: Category, member: int, tilt: float
) -> None:
    R, group = random_pose(seed)[:3, :3], category.symmetry
    like = R @ group.elements()[member % len(group.elements())]
    tilted = like @ Rotation.from_rotvec([0.0, tilt, 0.0]).as_matrix()
    assert metrics.axis_angle(tilted, R, group) == pytest.approx(tilt, abs=1e-6)


def test_shares_and_missing_estimates() -> None:
    angle, position = np.deg2rad([1.0, 4.0, 9.0, 50.0]), np.array([0.001, 0.015, 0.015, 0.001])
    share = metrics.shares(np.append(angle, np.inf), np.append(position, np.inf))
    assert share["2deg2mm"] == pytest.approx(1 / 5)
    assert share["5deg2cm"] == pytest.approx(2 / 5)
    assert share["5deg1cm"] == pytest.approx(1 / 5)
    assert share["10deg5cm"] == pytest.approx(3 / 5)


def test_the_papers_rule_forgives_what_the_prediction_calls_ambiguous() -> None:
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    none, z, everything = np.zeros(3), np.array([0.1, 0.2, 0.9]), np.ones(3)
    assert metrics.paper_rule_angle(quarter, np.eye(3), none) == pytest.approx(np.pi / 2)
    assert metrics.paper_rule_angle(quarter, np.eye(3), z) == pytest.approx(0, abs=1e-9)
    assert (
        metrics.paper_rule_angle(Rotation.from_euler("x", 90, degrees=True).as_matrix(), np.eye(3), everything) == 0.0
    )


def test_calibration_error_by_hand() -> None:
    confidence = np.array([0.95, 0.95, 0.25, 0.25])
    success = np.array([True, False, False, False])
    assert metrics.calibration_error(confidence, success) == pytest.approx(0.5 * 0.45 + 0.5 * 0.25)
    rng = np.random.default_rng(0)
    p = rng.random(20_000)
    assert metrics.calibration_error(p, rng.random(20_000) < p) < 0.02


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


def test_a_column_stands_beside_the_published_one() -> None:
    row = {"instances": 3, "paper_5deg2cm": 0.25, "paper_5deg5cm": 0.5, "paper_10deg5cm": 0.75}
    held_out = {"hammer_head": row, "average": {**row, "instances": 3}}
    groups = {"held-out": {"table": held_out}, "seen": {"table": {"average": {**row, "instances": 4}}}}
    tables = table1(groups, "symmetry-aware")
    narrow, _, wide = ({row[0]: row[1:] for row in table.rows} for table in tables)
    assert (narrow["hammer head"], wide["hammer head"]) == (["3", "0.250", "", "0.976"], ["3", "0.750", "", "0.997"])
    assert (narrow["average"], wide["average"]) == (["7", "0.250", "0.250", "0.985"], ["7", "0.750", "0.750", "0.998"])
    assert narrow["wrench jaw"] == ["0", "", "", "0.996"]
    assert all(len(row) == len(table.columns) for table in tables for row in table.rows)
    assert table1(groups, "ours")[0].rows[0] == tables[0].rows[0], "ours stands beside the paper's best column"


def test_without_weights_the_table_says_how_to_train_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["evaluate", "table1", "--weights", str(tmp_path)]) == 1
    assert "toolee train paper" in capsys.readouterr().err
