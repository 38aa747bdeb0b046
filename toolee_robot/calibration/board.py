"""The ChArUco board: its specification, its true scale, its drawing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array

MARKER_SHARE = 0.75
"""Edge of a marker, as a share of the square's."""
DICTIONARIES = ("DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250")
"""OpenCV's dictionaries of markers that a board may have: of the fewest bits, each of which is the larger."""
MODULES = 8
"""Modules along a square: a marker's six, and one of margin on either side."""
LARGEST_SCALING = 0.1
"""Largest deviation of a print's scale from the nominal one that is believed."""
LARGEST_SHEAR = 0.003
"""Largest difference between the scales along and across the sheet."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board, printed.

    Its frame: origin in the outer corner of the first square, x along the columns, y along the rows, z away from who
    looks at it (OpenCV). Chessboard corners are numbered along x first, from 0.

    Attributes:
        columns: Squares along x.
        rows: Squares along y.
        square: Edge of a square [m], as measured on the print.
        dictionary: Name of OpenCV's dictionary of markers.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    columns: int
    rows: int
    square: float
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3 or not 1e-3 < self.square < 1.0:
            raise UserError(
                f"a board of {self.columns} x {self.rows} squares of {self.square} m: give 3 x 3 squares or more, and "
                "metres"
            )
        if self.dictionary not in DICTIONARIES:
            raise UserError(f"dictionary {self.dictionary!r}: give one of {', '.join(DICTIONARIES)}")

    @property
    def size(self) -> tuple[float, float]:
        """Length along x and y of all squares [m]."""
        return self.columns * self.square, self.rows * self.square

    @property
    def center(self) -> Array:
        """Centre of the squares in the board's frame, (3,) [m]."""
        width, height = self.size
        return np.array([width / 2, height / 2, 0.0])

    @property
    def mark(self) -> Array:
        """The small white cross in the black square nearest to the middle, in the board's frame, (3,) [m].

        A nail goes through it where the board lies on the wood.
        """
        black = [(c, r) for c in range(self.columns) for r in range(self.rows) if (c + r) % 2 == 0]
        middle = (self.columns - 1) / 2, (self.rows - 1) / 2
        c, r = min(black, key=lambda at: (math.hypot(at[0] - middle[0], at[1] - middle[1]), at))
        return np.array([(c + 0.5) * self.square, (r + 0.5) * self.square, 0.0])

    @property
    def corners(self) -> Array:
        """Chessboard corners in the board's frame, (M, 3) [m], by number."""
        return np.asarray(self.charuco.getChessboardCorners(), np.float64)

    @property
    def charuco(self) -> Any:
        """OpenCV's `CharucoBoard`."""
        return _charuco(self)

    def measured(self, along: float, across: float) -> Board:
        """Apply the true scale of a print.

        Args:
            along: Measured length of the scale bar along x, which is as long as all columns [m].
            across: Measured length of the scale bar along y, which is as long as all rows [m].

        Returns:
            The board as printed.

        Raises:
            UserError: A length is implausible (`user.board_bar`), or the two have different scales: the print is
                distorted (`user.board_distorted`).
        """
        scales = along / self.size[0], across / self.size[1]
        for length, nominal, scale in zip((along, across), self.size, scales, strict=True):
            if not _is_print(scale):
                raise UserError(
                    f"a scale bar of {length * 1e3:.1f} mm cannot be a print of one of {nominal * 1e3:.0f} mm: "
                    f"{self._other_bars(along, across)}",
                    code="user.board_bar",
                )
        if abs(scales[0] - scales[1]) > LARGEST_SHEAR:
            raise UserError(
                f"the bars measure {along * 1e3:.1f} and {across * 1e3:.1f} mm instead of {self.size[0] * 1e3:.0f} and "
                f"{self.size[1] * 1e3:.0f}: the print is distorted by more than {LARGEST_SHEAR * 100:.1f} %; print it "
                "again without scaling",
                code="user.board_distorted",
            )
        return replace(self, square=self.square * (scales[0] + scales[1]) / 2)

    def _other_bars(self, along: float, across: float) -> str:
        """What to do about bars that are not this board's."""
        if _is_print(across / self.size[0]) and _is_print(along / self.size[1]):
            return "these are the two in the other order: give the longer one, along the columns, first"
        for sheet in SHEETS.values():
            x, y = sheet.board.size
            if _is_print(along / x) and _is_print(across / y):
                return f"these are the bars of the {sheet.name.upper()} board: give --sheet {sheet.name}"
        return "measure from end line to end line, and give it in millimetres"

    @property
    def rectangles(self) -> Array:
        """What is black: rectangles that touch without overlap, (R, 4): x, y, length along x, length along y [m]."""
        size = (self.columns * MODULES, self.rows * MODULES)
        black = np.asarray(self.charuco.generateImage(size, marginSize=0)) < 128
        found: list[tuple[int, int, int, int]] = []
        for y, line in enumerate(black):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], line, [0]])))
            found.extend((int(a), y, int(b - a), 1) for a, b in zip(edges[::2], edges[1::2], strict=True))
        return np.array(_merged(found), np.float64) * self.square / MODULES


def _is_print(scale: float) -> bool:
    return math.isfinite(scale) and abs(scale - 1.0) <= LARGEST_SCALING


def _merged(runs: list[tuple[int, int, int, int]]) -> list[tuple[int, int, int, int]]:
    """Join runs of equal extent in successive rows, so that no seam is printed between them."""
    merged: dict[tuple[int, int, int], int] = {}  # x, width, the row below -> index
    found: list[tuple[int, int, int, int]] = []
    for x, y, width, height in runs:
        above = merged.pop((x, width, y), None)
        if above is None:
            found.append((x, y, width, height))
            above = len(found) - 1
        else:
            found[above] = (x, found[above][1], width, found[above][3] + height)
        merged[x, width, y + height] = above
    return found


@lru_cache(maxsize=8)
def _charuco(board: Board) -> Any:
    import cv2  # here, since the station file's record names a board, and needs no OpenCV

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    return cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, MARKER_SHARE * board.square, dictionary)


@dataclass(frozen=True)
class Sheet:
    """A sheet of paper and the board that fills it.

    Attributes:
        name: Name of the format.
        width: Length of the longer edge [m].
        height: Length of the shorter edge [m].
        board: The board as it should be printed: no print is exactly so.
    """

    name: str
    width: float
    height: float
    board: Board


SHEETS = {
    "a4": Sheet("a4", 0.297, 0.210, Board(7, 5, 0.036)),
    "a3": Sheet("a3", 0.420, 0.297, Board(7, 5, 0.052)),
}
"""The sheets by name. A camera of 512 pixels in width finds an A4 up to 0.9 m away, an A3 up to 1.2 m."""
