"""A printed ChArUco board as visual bodies: a white sheet, and what is black on it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from toolee_robot.frames import Array, transform
from toolee_robot.render.mesh import Mesh, box
from toolee_robot.sim_backend.options import PlacedBoard
from toolee_robot.sim_backend.visuals.visual_body import VisualBody

MARGIN = 0.015
"""White margin around the squares [m]."""
_THICKNESS = 0.001
"""Thickness of the sheet, behind the printed plane [m]."""
_INK = 5e-5
"""Distance of the black faces before the sheet [m]."""
BOARD_ID = 7
"""Id of the board in ground-truth renderings."""


class BoardVisuals:
    """The visual bodies of a board; meshes are built once.

    Args:
        placed: The board.
    """

    def __init__(self, placed: PlacedBoard) -> None:
        self.placed = placed
        width, height = placed.board.size
        self._sheet = box((width + 2 * MARGIN, height + 2 * MARGIN, _THICKNESS))
        self._X_board_sheet = transform(p=placed.board.center + np.array([0.0, 0.0, _THICKNESS / 2]))
        self._ink = _faces(placed.board.rectangles)

    def bodies(self, X_base_flange: Array) -> Iterator[VisualBody]:
        """The visual bodies.

        Args:
            X_base_flange: Present pose of the flange, (4, 4).

        Yields:
            The sheet, and its black faces.
        """
        X = self.placed.X_frame_board
        if self.placed.on_flange:
            X = X_base_flange @ X
        white, black = (0.93, 0.93, 0.92), (0.05, 0.05, 0.05)
        yield VisualBody("board_sheet", self._sheet, X @ self._X_board_sheet, "paper", white, 0.9, body_id=BOARD_ID)
        yield VisualBody("board_ink", self._ink, X, "paper", black, 0.9, body_id=BOARD_ID)


def _faces(rectangles: Array) -> Mesh:
    """Rectangles (R, 4) as faces that look along -z."""
    x, y, w, h = rectangles.T
    z = np.full(len(x), -_INK)
    corners = np.stack([[x, y, z], [x + w, y, z], [x + w, y + h, z], [x, y + h, z]])  # (4, 3, R)
    vertices = corners.transpose(2, 0, 1).reshape(-1, 3)
    first = 4 * np.arange(len(x))[:, None]
    faces = np.concatenate([first + np.array(corner) for corner in ((0, 2, 1), (0, 3, 2))])
    return Mesh.build(vertices, faces)
