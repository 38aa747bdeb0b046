"""Sessions with images of a flat board, drawn without the renderer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.calibration_poses import Protocol, draw
from toolee_robot.calibration.board import SHEETS, Board
from toolee_robot.calibration.record import rows
from toolee_robot.calibration.session import Session, SessionPose, write_session
from toolee_robot.frames import Array, BaseFrame, inverse
from toolee_robot.station import CameraConfig, sim_station

CAMERA = sim_station().camera
BOARD = SHEETS["a3"].board
_PIXELS = 64


def picture(board: Board, X_camera_board: Array, camera: CameraConfig = CAMERA) -> NDArray[np.uint8]:
    """Image of a board on grey ground."""
    sheet = np.full(((board.rows + 1) * _PIXELS, (board.columns + 1) * _PIXELS), 255, np.uint8)
    size = (board.columns * _PIXELS, board.rows * _PIXELS)
    half = _PIXELS // 2
    sheet[half:-half, half:-half] = board.charuco.generateImage(size, marginSize=0)
    # Pixel centre (i, j) of the sheet -> board [m]: its squares begin at the outer edge of the first pixel.
    scale = board.square / _PIXELS
    to_board = np.array([[scale, 0, (0.5 - half) * scale], [0, scale, (0.5 - half) * scale], [0, 0, 1.0]])
    H = camera.intrinsics.matrix @ X_camera_board[:3, [0, 1, 3]] @ to_board
    factor = 6  # drawn larger and averaged: no aliasing
    S = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1.0]])
    large = cv2.warpPerspective(sheet, S @ H, (factor * camera.width, factor * camera.height), borderValue=120)
    small = cv2.resize(large, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


@dataclass(frozen=True)
class Drawn:
    """A session on disk and its truth."""

    session: Session
    X_base_camera: Array


def draw_session(
    folder: Path, poses: int = 10, frame: BaseFrame = BaseFrame.BASE_LINK,
    as_given: Callable[[Array], Array] = lambda X: X,
) -> Drawn:  # fmt: skip
    """Draw a session; `as_given` is what a person makes of the flange's poses."""
    X = CAMERA.X_base_camera
    drawn = draw(Protocol(poses, pixel=0.0, square_error=0.0), BOARD, CAMERA.intrinsics, X, np.random.default_rng(3))
    recorded = []
    for o in drawn.observations:
        name = f"{o.name}.png"
        X_camera_board = inverse(X) @ o.X_base_flange @ drawn.X_flange_board
        cv2.imwrite(str(folder / name), picture(BOARD, X_camera_board))
        recorded.append(SessionPose(name, X_base_flange=rows(as_given(o.X_base_flange))))
    session = Session("20185500001", "cam-7", CAMERA.intrinsics, tuple(recorded), frame=frame)
    write_session(folder, session)
    return Drawn(session, X)
