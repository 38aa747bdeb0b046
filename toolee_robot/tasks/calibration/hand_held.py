"""Views of a board that somebody holds before the camera: which of the images count."""

from __future__ import annotations

from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.intrinsics import CELLS, COVERED, DISTORTED_FLAT, covered_parts
from toolee_robot.calibration.observation import BoardView, find_board

STILL = 0.6
"""Motion of a corner from one image to the next up to which the board is held still [px]."""
ANEW = 0.05
"""Mean distance of the corners from those of another view from which on it is a new one, as a share of the width."""
COMMON = 4
"""Corners that two views must have in common to be compared."""


class Offered(StrEnum):
    """What became of an image."""

    TAKEN = "taken"
    UNSEEN = "the board is not seen"
    MOVING = "hold it still"
    KNOWN = "hold it otherwise"


class HandHeldViews:
    """Collects views of a board.

    Args:
        board: The board.
        size: Width and height of the images [px].
        count: Number of views that are wanted.

    Attributes:
        views: The views that count.
    """

    def __init__(self, board: Board, size: tuple[int, int], count: int) -> None:
        self._board, self._size, self._count = board, size, count
        self._last: BoardView | None = None
        self.views: list[BoardView] = []

    def offer(self, rgb: NDArray[np.uint8]) -> Offered:
        """Look at an image.

        Args:
            rgb: The image as the lens gives it, (H, W, 3).

        Returns:
            Whether it counts, or why not. It does if the board is where it was in the image before, and not where it
            was in any view that counts.
        """
        grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
        view = find_board(grey, self._board, DISTORTED_FLAT)
        last, self._last = self._last, view
        if view is None:
            return Offered.UNSEEN
        if last is None or (moved := _distances(last, view)) is None or moved.max() > STILL:
            return Offered.MOVING
        for other in self.views:
            apart = _distances(other, view)
            if apart is not None and apart.mean() < ANEW * self._size[0]:
                return Offered.KNOWN
        self.views.append(view)
        return Offered.TAKEN

    @property
    def covered(self) -> float:
        """Share of the image's parts in which the board was seen."""
        return len(covered_parts(self.views, self._size)) / CELLS**2

    @property
    def complete(self) -> bool:
        """Whether there are as many views as are wanted, all over the image."""
        return len(self.views) >= self._count and self.covered >= COVERED and not self.lacking

    @property
    def lacking(self) -> list[str]:
        """Corners of the image in which the board was not seen, such as "upper left"."""
        seen, last = covered_parts(self.views, self._size), CELLS - 1
        corners = {(0, 0): "upper left", (last, 0): "upper right", (0, last): "lower left", (last, last): "lower right"}
        return [name for part, name in corners.items() if part not in seen]


def _distances(a: BoardView, b: BoardView) -> NDArray[np.float64] | None:
    """Distances of the corners that two views have in common [px]; None where these are too few."""
    _, of_a, of_b = np.intersect1d(a.ids, b.ids, return_indices=True)
    if len(of_a) < COMMON:
        return None
    return np.asarray(np.linalg.norm(a.pixels[of_a] - b.pixels[of_b], axis=1), np.float64)
