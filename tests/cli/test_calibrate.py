"""A calibration in a simulated lab, and a station that works with its record and not with the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from tests.errors import raises
from toolee_robot.app.calibrate_camera import CameraJob, PlateViews
from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.record import read_record, rows, write_record
from toolee_robot.cli.app import run
from toolee_robot.cli.output import ConsoleListener
from toolee_robot.errors import ConfigError
from toolee_robot.frames import inverse
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.station import load_station, sim_station
from toolee_robot.stations.simulated import simulated_board

pytestmark = pytest.mark.sim(seconds=30)
TRUTH = sim_station().camera.X_base_camera


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    lab = simulated_board(sim_station(), SHEETS["a3"], 0.12, 1.2, 4)
    job = CameraJob(sim_station(), "a3", folder, ConsoleListener(Console()))
    with lab.build(4) as sim:
        job.collect(sim.station, lab.measured, lab.plate, lab.bars, PlateViews(12, 0.12, 1.2, 4))
    return folder


def test_a_simulated_lab_is_calibrated_without_knowing_the_truth(calibrated: Path) -> None:
    record = read_record(calibrated / "camera.json")
    off = (record.pose - TRUTH) @ [0.0, 0.0, 0.95, 1.0]
    assert 0.0 < np.linalg.norm(off) < 1e-3
    assert np.linalg.norm(off) < record.target_radius < 3e-3
    assert record.bars is not None
    assert all(pose.q is not None for pose in record.poses)
    assert len(record.poses) >= 10
    session = json.loads((calibrated / "poses.json").read_text())
    assert len(session["poses"]) == 12


def test_the_recorded_images_give_the_same_calibration_again(calibrated: Path, tmp_path: Path) -> None:
    record = read_record(calibrated / "camera.json")
    assert record.bars is not None
    bars = [f"{1e3 * length:.6f}" for length in record.bars]
    (tmp_path / "lab.yaml").write_text("version: 3\narm: {model: UR10}\n")
    command = ["calibrate", "camera", "--station", str(tmp_path / "lab.yaml"), "--images", str(calibrated)]
    assert run([*command, "--bars-mm", *bars, "--out", str(tmp_path / "out"), "--write"]) == 0
    assert load_station(tmp_path / "lab.yaml").calibration is not None, "entered beside the file"
    (again,) = (tmp_path / "out").iterdir()
    np.testing.assert_allclose(read_record(again / "camera.json").pose, record.pose, atol=1e-6)


def test_a_record_is_older_than_the_arms_kinematics_in_the_file(calibrated: Path, tmp_path: Path) -> None:
    """As of an arm whose joint was replaced, or whose factory calibration was entered after the camera's."""
    arm = {name: [1e-4] * 6 for name in ("delta_theta", "delta_a", "delta_d", "delta_alpha")}
    path, record = tmp_path / "station.yaml", {"record": str(calibrated / "camera.json")}
    path.write_text(json.dumps({"arm": {"calibration": arm}, "calibration": record}))
    with raises(ConfigError, says="the calibration was made with another") as caught:
        load_station(path)
    assert "delete the section `calibration`" in str(caught.value)


def test_the_task_believes_the_record_and_the_simulated_camera_stays(calibrated: Path, tmp_path: Path) -> None:
    record = read_record(calibrated / "camera.json")
    wrong = record.pose.copy()
    wrong[0, 3] += 0.1  # a record that nobody checked
    write_record(tmp_path / "camera.json", replace(record, X_base_camera=rows(wrong)))
    (tmp_path / "station.yaml").write_text("calibration: {record: camera.json}\n")
    config = load_station(tmp_path / "station.yaml")
    np.testing.assert_array_equal(config.camera.X_base_camera, wrong)
    images = []
    for station in (config, sim_station()):
        with SimStation.build(station, 0, SimOptions(hands_over=False)) as simulation:
            images.append(simulation.station.camera.read().rgb)
    np.testing.assert_array_equal(images[0], images[1])
    assert np.linalg.norm((inverse(TRUTH) @ wrong)[:3, 3]) > 0.09
