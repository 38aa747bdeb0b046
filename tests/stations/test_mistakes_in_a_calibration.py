"""Mistakes that a person is likely to make with the camera's calibration: each is named, with what to do."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.calibration.pictures import BOARD, CAMERA, draw_session
from toolee_robot.app import calibrate_camera
from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.session import read_session
from toolee_robot.cli.app import EXIT_USER, run
from toolee_robot.stations.simulated import SimulatedBoard, simulated_board
from toolee_robot.tasks.calibration.collect import UNSEEN

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
BARS = [f"{1e3 * length:.1f}" for length in BOARD.size]
Say = Callable[[], str]


@pytest.mark.parametrize(
    ("bars", "words"),
    [
        (SHEETS["a4"].board.size, "these are the bars of the A4 board: give --sheet a4"),
        (BOARD.size[::-1], "in the other order: give the longer one"),
        ((0.1 * BOARD.size[0], 0.1 * BOARD.size[1]), "measure from end line to end line, and give it in millimetres"),
    ],
    ids=["of the other sheet", "in the other order", "in centimetres"],
)
def test_bars_of_another_board_are_told_before_anything_moves(bars: tuple[float, float], words: str, said: Say) -> None:
    lengths = [f"{1e3 * length:.1f}" for length in bars]
    plate = ["--plate-distance", "0.12", "--plate-mass", "1.2"]
    assert run(["calibrate", "camera", "--station", str(LAB), "--bars-mm", *lengths, *plate]) == EXIT_USER
    assert words in said()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images of a board and the arm's poses, all right."""
    folder = tmp_path_factory.mktemp("session")
    draw_session(folder, 12)
    return folder


def _other_print(_: Path) -> list[str]:
    return ["--bars-mm", *(f"{1.03e3 * length:.1f}" for length in BOARD.size)]


def _swapped_poses(folder: Path) -> list[str]:
    P = np.eye(4)[[1, 0, 2, 3]]
    poses = json.loads((folder / "poses.json").read_text())
    for pose in poses["poses"]:
        pose["X_base_flange"] = (P @ np.array(pose["X_base_flange"]) @ P).tolist()
    (folder / "poses.json").write_text(json.dumps(poses))
    return ["--bars-mm", *BARS]


def _camera_in_file(folder: Path, x: float, y: float) -> list[str]:
    text = f"frame: base_link\ncamera: {{position: [{x}, {y}, 0.86], target: [0.61, -0.17, 0.7]}}\n"
    (folder / "lab.yaml").write_text(text)
    return ["--bars-mm", *BARS, "--config", str(folder / "lab.yaml")]


def _swapped_camera(folder: Path) -> list[str]:
    return _camera_in_file(folder, -0.60, 0.93)


def _turned_camera(folder: Path) -> list[str]:
    return _camera_in_file(folder, -0.93, 0.60)


def _depth_in_millimetres(folder: Path) -> list[str]:
    poses = json.loads((folder / "poses.json").read_text())
    for pose in poses["poses"]:
        pose["depth"] = f"depth_{pose['image']}"
        cv2.imwrite(str(folder / pose["depth"]), np.full((CAMERA.height, CAMERA.width), 800, np.uint16))
    (folder / "poses.json").write_text(json.dumps({**poses, "depth_unit": 1.0}))
    return ["--bars-mm", *BARS]


@pytest.mark.sim(seconds=5)
@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (_other_print, "Measure the scale bars of the print again"),
        (_swapped_poses, "They fit with x and y swapped"),
        (_swapped_camera, "the board on another robot; or x and y are swapped there"),
        (_turned_camera, "the station file's `frame` names the other base"),
        (_depth_in_millimetres, "so depth_unit is wrong"),
    ],
)
def test_a_calibration_from_images_names_the_mistake(
    mistake: Callable[[Path], list[str]], words: str, session: Path, tmp_path: Path, said: Say
) -> None:
    folder, out = tmp_path / "session", tmp_path / "out"
    shutil.copytree(session, folder)
    options = mistake(folder)
    assert run(["calibrate", "camera", "--images", str(folder), "--out", str(out), *options]) == EXIT_USER
    assert words in said()
    assert not out.exists()


@pytest.mark.sim(seconds=5)
def test_the_arm_does_not_go_on_before_a_camera_that_stands_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: Say
) -> None:
    """x and y of its place are swapped in the file: the views are before the place that the file says."""

    def swapped(*drawn: Any) -> SimulatedBoard:
        printed = simulated_board(*drawn)
        camera = printed.measured.camera
        assert camera.position is not None
        assert camera.target is not None
        (x, y, z), (a, b, c) = camera.position, camera.target
        camera = replace(camera, position=(y, x, z), target=(b, a, c))
        return replace(printed, measured=replace(printed.measured, camera=camera))

    monkeypatch.setattr(calibrate_camera, "simulated_board", swapped)
    assert run(["calibrate", "camera", "--poses", "10", "--seed", "3", "--out", str(tmp_path)]) == EXIT_USER
    told = said()
    assert "none of the first 4 images shows the board" in told
    assert "x and y swapped, or half a turn of the base" in told
    (kept,) = tmp_path.iterdir()
    assert f"give --images {kept}" in told
    session = read_session(kept)
    assert len(session.poses) == UNSEEN
    assert all((kept / pose.image).is_file() for pose in session.poses)
