"""The record of a calibrated camera's pose: a JSON file that a station file names.

It holds a hash over its content: it shows alteration by mistake or by an editor, not by somebody who signs again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.calibration.board import Board
from toolee_robot.errors import ConfigError, words_of
from toolee_robot.frames import HALF_TURN, Array, is_rigid
from toolee_robot.runtime.files import read_json, write_atomic
from toolee_robot.runtime.yaml_files import to_record
from toolee_robot.types import CameraIntrinsics, DhCalibration

FORMAT = "toolee camera calibration 1"
"""Name and version of the format."""
FARTHEST = 20.0
"""Of a camera from the base, and of a board from the flange [m]."""
ELSEWHERE = 0.3
"""Distance of a calibrated camera from where a person has measured it over which one of the two is wrong [m]."""
Row = tuple[float, ...]
Rows = tuple[Row, ...]
"""A matrix, row by row."""
_STRICT = {"extra": "forbid", "allow_inf_nan": False}
ROUNDED = 1e-4
"""Largest difference of two coefficients that are the same but for rounding: under 0.05 px at the image's corners."""
SIGNATURE = "sha256"
"""The file's key that holds the hash."""


@dataclass(frozen=True)
class RecordedPose:
    """One pose of the arm, what was seen there, and how it fits.

    Attributes:
        name: Its name.
        q: Joint positions of the arm, (6,) [rad]; None where the flange's pose was given as such.
        X_base_flange: Pose of the flange in `base`, 4 x 4 [m].
        ids: Numbers of the board's corners in the image.
        pixels: Places of the corners, M x 2 [px].
        reprojection: Root mean square reprojection error [px].
        held_out: Root mean square distance of the corners from where the other poses expect them, across the line of
            sight [m].
        weight: Weight in the fit, 1 for a pose that fits.
    """

    __pydantic_config__ = _STRICT
    name: str
    q: Row | None
    X_base_flange: Rows
    ids: tuple[int, ...]
    pixels: Rows
    reprojection: float
    held_out: float
    weight: float


@dataclass(frozen=True)
class TouchCheck:
    """A point that the camera measured and the robot touched.

    Attributes:
        measured_at: Date and time, ISO 8601.
        what: Which point, such as a corner of a board.
        seen: Its place in `base` by the camera, (3,) [m].
        touched: Its place in `base` by the arm, (3,) [m].
        error: Distance of the two [m].
        allowed: Distance that the calibration and the measurement explain with a probability of 95 % [m].
    """

    __pydantic_config__ = _STRICT
    measured_at: str
    what: str
    seen: tuple[float, float, float]
    touched: tuple[float, float, float]
    error: float
    allowed: float


@dataclass(frozen=True)
class CalibrationRecord:
    """A camera calibration, all that it was computed from, and how far it can be relied on.

    All poses are in `base`, ROS's base_link.

    Attributes:
        format: `FORMAT`.
        measured_at: Date and time of the solution, ISO 8601.
        software: Version of this software.
        robot_model: Model of the arm.
        robot_serial: Serial number of the arm.
        kinematics: Factory calibration of the arm that the flange's poses were computed with; None for nominal ones,
            or where the poses were given.
        camera_serial: Serial number of the camera.
        intrinsics: Pinhole model of the camera's images.
        board: The board, its square as measured.
        bars: Measured lengths of the board's two scale bars [m]; None where the square itself was measured.
        X_base_camera: Pose of the camera, 4 x 4 [m].
        X_flange_board: Pose of the board, 4 x 4 [m].
        covariance: Covariance of the camera's position [m] and rotation vector [rad], axes of `base`, 6 x 6.
        freedom: Degrees of freedom of the covariance.
        pixel_noise: Standard deviation of a corner's place about one axis [px].
        arm_noise: Standard deviations of the arm's position [m] and rotation [rad] about one axis.
        residual: Root mean square error of the board's corners on held-out poses, across the line of sight [m].
        largest_shift: Largest displacement of the target when one pose is left out [m].
        target: The point at which errors are told, camera frame, (3,) [m].
        target_radius: Largest half axis of the region that has the target's true place with a probability of 95 % [m].
        methods: Displacement of the target by the closed form [m].
        rotations: Largest rotation between two poses, and that about an axis across its own [rad].
        board_scale: Factor on the square that the poses themselves tell, and its standard deviation.
        poses: The poses.
        checks: Touch tests.
        distortion: Distortion by which the images were undistorted, k1, k2, p1, p2 and possibly k3, as the station file
            stated it; None where it stated none.
    """

    __pydantic_config__ = _STRICT
    format: str
    measured_at: str
    software: str
    robot_model: str
    robot_serial: str
    kinematics: DhCalibration | None
    camera_serial: str
    intrinsics: CameraIntrinsics
    board: Board
    bars: tuple[float, float] | None
    X_base_camera: Rows
    X_flange_board: Rows
    covariance: Rows
    freedom: float
    pixel_noise: float
    arm_noise: tuple[float, float]
    residual: float
    largest_shift: float
    target: tuple[float, float, float]
    target_radius: float
    methods: dict[str, float]
    rotations: tuple[float, float]
    board_scale: tuple[float, float]
    poses: tuple[RecordedPose, ...]
    checks: tuple[TouchCheck, ...] = ()
    distortion: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.format != FORMAT:
            raise ValueError(f"format {self.format!r}: this software reads {FORMAT!r}")
        datetime.fromisoformat(self.measured_at)
        if wrong := self.intrinsics.problems():
            raise ValueError(f"intrinsics.{wrong[0][0]}: {wrong[0][1]}")
        for name in ("X_base_camera", "X_flange_board"):
            X = np.array(getattr(self, name))
            if X.shape != (4, 4) or not is_rigid(X):
                raise ValueError(f"{name} is not a rigid transform")
            if np.linalg.norm(X[:3, 3]) > FARTHEST:
                raise ValueError(f"{name} is over {FARTHEST:g} m away")
        covariance = np.array(self.covariance)
        if covariance.shape != (6, 6) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
            raise ValueError("covariance is not a positive definite 6 x 6 matrix")

    @property
    def pose(self) -> Array:
        """X_base_camera, (4, 4)."""
        return np.array(self.X_base_camera)

    def checked(self, check: TouchCheck) -> CalibrationRecord:
        """The record with a touch test more."""
        return replace(self, checks=(*self.checks, check))


def rows(matrix: Array) -> Rows:
    """A matrix as a record holds it."""
    return tuple(tuple(float(v) for v in row) for row in matrix)


def write_record(path: Path, record: CalibrationRecord) -> str:
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


def write_signed(path: Path, data: dict[str, Any]) -> str:
    """As `write_record`, of what JSON can hold, finite numbers only."""
    signature = _signature(data)
    text = json.dumps({**data, SIGNATURE: signature}, indent=1, allow_nan=False)
    write_atomic(path, (text + "\n").encode())
    return signature


def read_record(path: Path) -> CalibrationRecord:
    """Read the record of a camera's pose and check its signature.

    Args:
        path: The file.

    Returns:
        The record.

    Raises:
        ConfigError: It cannot be read, was altered, or is no valid
            record.
    """
    what = "camera calibration"
    try:
        data = read_json(path)
    except (OSError, ValueError) as error:
        message = f"cannot read the {what} {path} that `toolee calibrate` writes: {words_of(error)}"
        raise ConfigError(message) from error
    if not isinstance(data, dict) or SIGNATURE not in data:
        raise ConfigError(f"{path} is not the {what}: name a file that `toolee calibrate` wrote")
    signature = data.pop(SIGNATURE)
    if signature != _signature(data):
        raise ConfigError(
            f"{path} was altered since it was written: nothing in it can be relied on; take the original, or calibrate "
            "again"
        )
    return to_record(data, path, CalibrationRecord, what)


def _signature(data: dict[str, Any]) -> str:
    # As the file will be read: tuples are lists there.
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def same_distortion(a: Sequence[float] | None, b: Sequence[float] | None) -> bool:
    """Whether two distortions are the same but for rounding.

    Args:
        a: k1, k2, p1, p2 and possibly k3; None for none, which is the same as zeros.
        b: The other.

    Returns:
        Whether they are.
    """
    return all(abs(x - y) <= ROUNDED for x, y in zip_longest(a or (), b or (), fillvalue=0.0))


def camera_is_elsewhere(place: Array, expected: Array) -> bool:
    """Whether a calibrated camera stands too far from where a person has measured it.

    Args:
        place: The calibrated camera's place in `base`, (3,) [m].
        expected: Its place as measured by hand, in `base`, (3,) [m].

    Returns:
        True over `ELSEWHERE`.
    """
    return float(np.linalg.norm(place - expected)) > ELSEWHERE


def half_a_turn_apart(place: Array, expected: Array) -> bool:
    """Whether half a turn of the base explains that a camera is elsewhere.

    Args:
        place: The calibrated camera's place in `base`, (3,) [m].
        expected: Its place as measured by hand, in `base`, (3,) [m].

    Returns:
        True if after half a turn about z they agree.
    """
    return not camera_is_elsewhere(HALF_TURN[:3, :3] @ place, expected)


HALF_A_TURN = (
    "they differ by half a turn about the base's z. Either the flange's poses or the station file's positions are in "
    "the other base frame. Correct `frame` in that file. Joint angles have no frame"
)
"""What a person reads then."""


def axes_swapped(place: Array, expected: Array) -> bool:
    """Tell whether swapped numbers explain that a camera is elsewhere.

    Args:
        place: The calibrated camera's place in `base`, (3,) [m].
        expected: Its place as measured by hand, in `base`, (3,) [m].

    Returns:
        True if with x and y of one of them swapped they agree.
    """
    return not camera_is_elsewhere(place[[1, 0, 2]], expected)
