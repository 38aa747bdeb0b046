"""The record of a camera's intrinsics, which a station file names in `camera.intrinsics`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import zip_longest
from pathlib import Path

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.signed import read_signed, write_signed
from toolee_robot.types import CameraIntrinsics

FORMAT = "toolee camera intrinsics 1"
"""Name and version of the format."""
DISTORTED = 0.3
"""Displacement of a pixel by the lens from which on images must be undistorted [px]."""
ROUNDED = 1e-4
"""Largest difference of two coefficients that are the same but for rounding: under 0.05 px at the image's corners."""


@dataclass(frozen=True)
class IntrinsicsRecord:
    """Intrinsics, and how far they can be relied on.

    Attributes:
        format: `FORMAT`.
        measured_at: Date and time, ISO 8601.
        software: Version of this software.
        camera_serial: Serial number of the camera.
        board: The board, its square as measured.
        intrinsics: The pinhole model.
        distortion: k1, k2, p1, p2 of OpenCV's model; they hold for images as the camera gives them.
        sigma: Standard deviations of fx, fy, cx, cy [px].
        sigma_distortion: Standard deviations of the distortion.
        reprojection: Root mean square reprojection error of all views [px].
        held_out: The same of views that took no part, each by the others of its fifth left out [px].
        largest_distortion: Largest displacement of a pixel by the lens, in the part of the image that has corners [px].
        covered: Share of the image's parts that have corners.
        views: Number of views.
        left_out: Number of corners that did not fit the others and took no part.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    format: str
    measured_at: str
    software: str
    camera_serial: str
    board: Board
    intrinsics: CameraIntrinsics
    distortion: tuple[float, ...]
    sigma: tuple[float, ...]
    sigma_distortion: tuple[float, ...]
    reprojection: float
    held_out: float
    largest_distortion: float
    covered: float
    views: int
    left_out: int = 0

    def __post_init__(self) -> None:
        if self.format != FORMAT:
            raise ValueError(f"format {self.format!r}: this software reads {FORMAT!r}")
        if wrong := self.intrinsics.problems():
            raise ValueError(f"intrinsics.{wrong[0][0]}: {wrong[0][1]}")

    @property
    def distorts(self) -> bool:
        """Whether images must be undistorted before anything is measured in them."""
        return self.largest_distortion > DISTORTED


def write_intrinsics(path: Path, record: IntrinsicsRecord) -> str:
    """Sign and write a record.

    Args:
        path: The file; its folder exists.
        record: The record.

    Returns:
        The signature, hexadecimal.

    Raises:
        UserError: The file cannot be written.
    """
    return write_signed(path, asdict(record))


def read_intrinsics(path: Path) -> IntrinsicsRecord:
    """Read a record and check its signature.

    Args:
        path: The file.

    Returns:
        The record.

    Raises:
        ConfigError: As `read_signed`.
    """
    return read_signed(path, IntrinsicsRecord, "record of intrinsics")


def same_distortion(a: Sequence[float] | None, b: Sequence[float] | None) -> bool:
    """Whether two distortions are the same but for rounding.

    Args:
        a: k1, k2, p1, p2 and possibly k3; None for none, which is the same as zeros.
        b: The other.

    Returns:
        Whether they are.
    """
    return all(abs(x - y) <= ROUNDED for x, y in zip_longest(a or (), b or (), fillvalue=0.0))
