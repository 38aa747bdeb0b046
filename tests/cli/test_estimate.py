"""`toolee estimate` on files: frames of tools that no network was trained on, in a BOP folder and alone."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from toolee_robot.cli.app import run
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import is_rigid
from toolee_robot.perception import ToolPerception
from toolee_robot.perception.io import bop_images
from toolee_robot.perception.offline.dataset.records import Example
from toolee_robot.perception.offline.synthesis.example import Series, make_example, render_example

pytestmark = [pytest.mark.sim, pytest.mark.usefixtures("networks_once")]

_HEAD = CATEGORIES.index(Category.HAMMER_HEAD) + 1
_STATION = 1
"""The kind of scene that shows a tool in the robot's hand."""
_KEYS = {"category", "score", "X_camera_ee", "covariance", "mask_box", "confidence", "trust", "usable", "reason"}


def _clear_view(example: Example) -> bool:
    """A hammer head in the robot's station, well in view."""
    table = example.table
    heads = table.category == _HEAD
    return bool(np.any(heads & (table.visible > 250) & (table.occlusion < 0.2)))


@pytest.fixture(scope="module")
def examples() -> list[Example]:
    found = []
    for index in range(200):
        if render_example(Series(7, "test"), index).sample.kind == _STATION:
            example = make_example(Series(7, "test"), index)
            found += [example] if _clear_view(example) else []
        if len(found) == 2:
            return found
    raise AssertionError("the data set shows no hammers")


@pytest.fixture(scope="module")
def scene(examples: list[Example], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A BOP folder with images 0 and 4; depth in tenths of a millimetre."""
    folder = tmp_path_factory.mktemp("scene")
    (folder / "rgb").mkdir()
    (folder / "depth").mkdir()
    cameras = {}
    for k, example in enumerate(examples):
        name = f"{4 * k:06d}.png"
        cv2.imwrite(str(folder / "rgb" / name), example.rgb[:, :, ::-1])
        cv2.imwrite(str(folder / "depth" / name), (example.depth_mm.astype(np.uint32) * 10).clip(0, 65535).astype("u2"))
        cameras[str(4 * k)] = {"cam_K": example.intrinsics.matrix.reshape(-1).tolist(), "depth_scale": 0.1}
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    return folder


def _check(record: dict[str, Any]) -> None:
    assert set(record) == _KEYS
    assert record["category"] in list(Category)
    assert 0.0 <= record["score"] <= 1.0
    x0, y0, x1, y1 = record["mask_box"]
    assert x0 < x1
    assert y0 < y1
    if record["X_camera_ee"] is None:
        assert not record["usable"]
        return
    assert is_rigid(np.reshape(record["X_camera_ee"], (4, 4)))
    covariance = np.array(record["covariance"])
    assert covariance.shape == (6, 6)
    assert np.linalg.eigvalsh(covariance)[0] > 0
    assert record["reason"]


def test_a_bop_scene_gives_one_line_a_frame_and_what_the_perception_sees_there(
    scene: Path, examples: list[Example], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["estimate", "--bop", str(scene), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["im_id"] for line in lines] == [0, 4]
    for line in lines:
        assert set(line) == {"im_id", "time_ms", "estimates"}
        assert line["time_ms"] > 0
        for record in line["estimates"]:
            _check(record)
    printed = [r for r in lines[0]["estimates"] if r["usable"]]
    frame = bop_images(scene)[0].read()
    np.testing.assert_array_equal(frame.rgb, examples[0].frame.rgb)
    # Not the same to the last bit, which decides where the networks see two poses that are about as good.
    np.testing.assert_allclose(frame.depth, examples[0].frame.depth, atol=1e-6)
    expected = [e for e in ToolPerception.load().estimate(frame) if e.usable]
    assert Category.HAMMER_HEAD in [r["category"] for r in printed]
    assert [r["category"] for r in printed] == [e.category for e in expected]
    for record, estimate in zip(printed, expected, strict=True):
        np.testing.assert_allclose(np.reshape(record["X_camera_ee"], (4, 4)), estimate.X_camera_ee, atol=1e-4)


def test_a_bop_scene_without_a_usable_pose_is_exit_1(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "scene"
    shutil.copytree(scene, empty)
    for path in (empty / "rgb").iterdir():
        cv2.imwrite(str(path), np.full_like(cv2.imread(str(path)), 128))
    for path in (empty / "depth").iterdir():
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), np.full_like(depth, 800))
    assert run(["estimate", "--bop", str(empty), "--json"]) == 1
    assert "0 of 2 frames" in capsys.readouterr().err


def test_one_unreadable_frame_does_not_cost_the_others(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "scene"
    shutil.copytree(scene, broken)
    (broken / "rgb" / "000004.png").write_text("not an image")
    assert run(["estimate", "--bop", str(broken), "--json"]) == 2
    captured = capsys.readouterr()
    *lines, failure = [json.loads(line) for line in captured.out.splitlines()]
    assert [line["im_id"] for line in lines] == [0, 4]
    assert [("error" in line) for line in lines] == [False, True]
    assert failure["error"]["code"] == "user"
    assert "000004.png" in captured.err


def test_one_frame_gives_a_list_a_table_and_a_picture(
    scene: Path, examples: list[Example], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    k = examples[0].intrinsics
    args = ["estimate", "--rgb", str(scene / "rgb" / "000000.png"), "--depth", str(scene / "depth" / "000000.png")]
    args += ["--depth-scale", "0.0001", "--intrinsics", f"{k.fx},{k.fy},{k.cx},{k.cy}"]
    picture = tmp_path / "seen.png"
    code = run([*args, "--json", "--picture", str(picture)])
    records = json.loads(capsys.readouterr().out)
    assert code == (0 if any(r["usable"] for r in records) else 1)
    assert records
    for record in records:
        _check(record)
    assert cv2.imread(str(picture)) is not None
    assert run([*args, "--json", "--picture", str(tmp_path / "no" / "such.png")]) == 2
    assert json.loads(capsys.readouterr().out.splitlines()[0]) == records, "a bad place does not cost the estimates"
    assert run(args) == code
    assert "hammer head" in capsys.readouterr().out
