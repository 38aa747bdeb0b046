"""The board: its drawing is OpenCV's, its scale is asked, its corners are found where they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.calibration.pictures import BOARD, CAMERA, picture
from tests.examples import seldom
from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.observation import camera_board, find_board
from toolee_robot.calibration.sheet import board_pdf
from toolee_robot.control import RobotModel
from toolee_robot.errors import UserError
from toolee_robot.frames import inverse, rotation_angle, transform, transform_points
from toolee_robot.station import sim_station
from toolee_robot.stations.simulated import simulated_board
from toolee_robot.tasks.calibration.views import TILT, plan_views


@pytest.mark.parametrize("name", SHEETS)
def test_what_is_printed_is_what_opencv_draws_and_fits_its_sheet(name: str) -> None:
    sheet = SHEETS[name]
    board, p = sheet.board, 40
    mine = np.full((board.rows * p, board.columns * p), 255, np.uint8)
    for x, y, w, h in np.round(board.rectangles / board.square * p).astype(int):
        assert np.all(mine[y : y + h, x : x + w] == 255), "rectangles overlap"
        mine[y : y + h, x : x + w] = 0
    np.testing.assert_array_equal(mine, board.charuco.generateImage(mine.shape[::-1], marginSize=0))
    assert board.size[0] < sheet.width - 0.02
    assert board.size[1] < sheet.height - 0.02
    pdf = board_pdf(sheet)
    assert pdf.startswith(b"%PDF")
    points = [round(length / 0.0254 * 72) for length in (sheet.width, sheet.height)]
    box = pdf.partition(b"/MediaBox [")[2].partition(b"]")[0].split()
    assert [round(float(value)) for value in box[2:]] == points, "the sheet has its true size"
    assert board_pdf(sheet) == pdf


def test_the_true_scale_of_a_print_is_that_of_its_bars() -> None:
    x, y = BOARD.size
    printed = BOARD.measured(0.99 * x, 0.991 * y)
    assert printed.square == pytest.approx(0.9905 * BOARD.square)
    assert printed != BOARD
    for bars, code in (((x * 1e3, y * 1e3), "user.board_bar"), ((x, 0.99 * y), "user.board_distorted")):
        with pytest.raises(UserError) as error:
            BOARD.measured(*bars)
        assert error.value.code == code


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    st.floats(0.5, 1.0), st.floats(0.0, TILT[1]), st.floats(-np.pi, np.pi), st.floats(-3.0, 3.0),
    st.floats(-0.1, 0.1), st.floats(-0.08, 0.08),
)  # fmt: skip
def test_corners_are_found_to_a_fraction_of_a_pixel(
    depth: float, tilt: float, direction: float, turn: float, x: float, y: float
) -> None:
    """Up to the largest tilt that docs/how-to/calibrate.md asks for; of 2,000 images at its edges 3 have 0.155 px."""
    tilted = Rotation.from_rotvec(tilt * np.array([np.cos(direction), np.sin(direction), 0.0]))
    R = (tilted * Rotation.from_rotvec([0.0, 0.0, turn])).as_matrix()
    X = transform(R, np.array([depth * x, depth * y, depth]) - R @ BOARD.center)
    view = find_board(picture(BOARD, X), BOARD)
    assert view is not None
    p = transform_points(X, BOARD.corners[view.ids])
    expected = np.column_stack([CAMERA.fx * p[:, 0] / p[:, 2] + CAMERA.cx, CAMERA.fy * p[:, 1] / p[:, 2] + CAMERA.cy])
    off = np.linalg.norm(view.pixels - expected, axis=1)
    assert np.median(off) < 0.15
    assert off.max() < 1.0
    assert np.abs(np.mean(view.pixels - expected, axis=0)).max() < 0.1, "no systematic shift, such as half a pixel"
    found, ratio = camera_board(view, BOARD, CAMERA.intrinsics)
    if ratio > 2.0:
        assert rotation_angle(found[:3, :3].T @ R) < np.deg2rad(3.0)


@pytest.mark.sim(seconds=5)
@pytest.mark.parametrize("seed", seldom(0, 1))
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
