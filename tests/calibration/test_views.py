"""Which views of the board are planned, and in what order."""

from __future__ import annotations

import numpy as np
import pytest

from toolee_robot.calibration.board import SHEETS
from toolee_robot.control import RobotModel
from toolee_robot.frames import inverse
from toolee_robot.station import sim_station
from toolee_robot.stations.simulated import simulated_board
from toolee_robot.tasks.calibration.views import plan_views


@pytest.mark.sim(seconds=5)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_first_view_has_the_board_nearest_to_the_middle_of_the_image(seed: int) -> None:
    """The others may all be lost if the camera is not quite where it was measured."""
    printed = simulated_board(sim_station(), SHEETS["a3"], 0.12, 1.2, seed)
    config, plate = printed.measured, printed.plate
    robot, camera = RobotModel.of_station(config), config.camera
    off = []
    for q in plan_views(robot, config, plate, 12, seed):
        X_camera_board = inverse(camera.X_base_camera) @ robot.arm.fk(q) @ plate.X_flange_board
        center = camera.intrinsics.project((X_camera_board @ [*plate.board.center, 1.0])[:3])
        off.append(float(np.linalg.norm(center - [camera.width / 2, camera.height / 2])))
    assert len(off) == 12
    assert np.argmin(off) == 0
