"""A nail by the camera: found to its stated uncertainty on rendered frames, refused where it cannot be right."""

from __future__ import annotations

from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.nail import SimulatedNailBoard, simulated_nail_board
from tests.errors import raises
from toolee_robot.app.calibrate_nail import known_camera
from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.nail import see_nail
from toolee_robot.cli.app import run
from toolee_robot.errors import ConfigError, NotReadyError, UserError
from toolee_robot.frames import angle_between
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.station import SIMULATED_CALIBRATION, sim_station
from toolee_robot.stations.simulated import place_board
from toolee_robot.tasks.calibration.collect import mean_frame

CONFIG = sim_station()
SHEET = SHEETS["a3"]


@pytest.fixture(scope="module")
def lab() -> SimulatedNailBoard:
    return simulated_nail_board(CONFIG, SHEET, 5)


@pytest.fixture(scope="module")
def images(lab: SimulatedNailBoard) -> tuple[Any, Any]:
    with lab.build() as simulation:
        return mean_frame(simulation.station.camera, 3)


@pytest.mark.sim(seconds=30)
def test_the_nail_is_found_to_its_uncertainty(lab: SimulatedNailBoard, images: tuple[Any, Any]) -> None:
    nail = see_nail(lab.camera, lab.board, lab.on_wood, *images)
    off = nail.entry - lab.entry
    assert off @ np.linalg.solve(nail.covariance, off) < 16.3, "99.9 %"
    assert np.linalg.norm(off) < 3e-3
    assert angle_between(nail.up, lab.up) < np.deg2rad(0.3)


@pytest.mark.nightly
@pytest.mark.sim(seconds=30)
def test_another_size_of_the_board_is_noticed(lab: SimulatedNailBoard, images: tuple[Any, Any]) -> None:
    wrong = replace(lab.board, square=1.06 * lab.board.square)
    with raises(UserError, says="Check --sheet, and measure both scale"):
        see_nail(lab.camera, wrong, lab.on_wood, *images)


@pytest.mark.sim(seconds=30)
def test_an_image_without_the_board_is_refused(lab: SimulatedNailBoard, images: tuple[Any, Any]) -> None:
    with raises(UserError, says="no board is seen in the image"):
        see_nail(lab.camera, lab.board, lab.on_wood, np.zeros_like(images[0]))


@pytest.mark.nightly
@pytest.mark.sim(seconds=30)
def test_a_board_that_does_not_lie_on_the_wood_is_refused(lab: SimulatedNailBoard) -> None:
    leaning = place_board(CONFIG, SHEET.board, 0.001, 0.3, np.array([-0.14, 0.0]))
    with SimStation.build(CONFIG, 1, SimOptions(hands_over=False, boards=(leaning,))) as simulation:
        rgb, depth = mean_frame(simulation.station.camera, 2)
    with raises(UserError, says="the board is tilted by"):
        see_nail(lab.camera, SHEET.board, lab.on_wood, rgb, depth)


def test_a_calibration_that_does_not_hold_is_refused() -> None:
    path = Path("station.yaml")
    with SimStation.build(CONFIG) as simulation:
        old = replace(SIMULATED_CALIBRATION, measured_on="2026-01-01", valid_days=30.0)
        assert (date.today() - date(2026, 1, 1)).days > 30
        with raises(NotReadyError, says="the camera's calibration is not valid"):
            known_camera(replace(CONFIG, calibration=old), path, simulation.station)
        with raises(ConfigError, says="the station file names no calibration"):
            known_camera(replace(CONFIG, calibration=None), path, simulation.station)


@pytest.mark.parametrize(
    "options",
    [
        ["--station", "examples/lab.yaml"],
        ["--station", "examples/lab.yaml", "--rehearse", "--bars-mm", "361.3", "258.1"],
        ["--station", "examples/lab.yaml", "--rehearse", "--nail", "another"],
    ],
)
def test_options_that_contradict_each_other_are_refused(options: list[str]) -> None:
    assert run(["calibrate", "nail", *options]) == 2
