"""A folder of images and of the arm's poses at them: what a calibration is computed from, and can be again.

`poses.json` is a `Session`; the images lie where it says, relative to it. An image is 8 bit, a depth image 16 bit PNG.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.hand_eye.diagnosis import check_depths, check_poses
from toolee_robot.calibration.hand_eye.solve import CameraCalibration
from toolee_robot.calibration.observation import Observation, camera_board, find_board
from toolee_robot.calibration.record import FORMAT, CalibrationRecord, RecordedPose, Row, Rows, rows
from toolee_robot.errors import UserError, words_of
from toolee_robot.frames import Array, BaseFrame, rotation_angle, transform_points
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.images import read_image as read_pixels
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.types import CameraIntrinsics, DhCalibration

FILE = "poses.json"
"""The file in the folder."""
DISAGREEING = 0.02, float(np.deg2rad(2.0))
"""Difference between a given pose and that by the joint positions above which one of them is wrong [m], [rad]."""
LARGEST_JOINT = 2.0 * np.pi + 0.1
"""Largest position of a joint of a UR [rad]: two turns, and a little for its encoder."""
_STRICT = {"extra": "forbid", "allow_inf_nan": False}


@dataclass(frozen=True)
class SessionPose:
    """An image, and where the arm stood.

    Attributes:
        image: The colour or grey image's file.
        q: Joint positions of the arm as the robot reports them, (6,) [rad].
        X_base_flange: Pose of the flange, 4 x 4 [m], in the session's frame; given where `q` is not known.
        depth: The depth image's file, registered to the colour image.
    """

    __pydantic_config__ = _STRICT
    image: str
    q: Row | None = None
    X_base_flange: Rows | None = None
    depth: str | None = None

    def __post_init__(self) -> None:
        if self.q is None and self.X_base_flange is None:
            raise ValueError(f"{self.image}: give q, the joint positions, or X_base_flange")
        if self.q is not None and len(self.q) != 6:
            raise ValueError(f"{self.image}: q has {len(self.q)} numbers, an arm has 6 joints")
        if self.q is not None and max(map(abs, self.q)) > LARGEST_JOINT:
            raise ValueError(f"{self.image}: q looks like degrees, as the teach pendant shows them: give radians")


@dataclass(frozen=True)
class Session:
    """Images and poses of one calibration.

    Attributes:
        robot_serial: Serial number of the arm.
        camera_serial: Serial number of the camera.
        intrinsics: Pinhole model of the images, which are free of distortion.
        poses: The poses.
        frame: Frame of every `X_base_flange`; needed where one is given.
        depth_unit: Length of one step of the depth images [m]; needed where one is given.
    """

    __pydantic_config__ = _STRICT
    robot_serial: str
    camera_serial: str
    intrinsics: CameraIntrinsics
    poses: tuple[SessionPose, ...]
    frame: BaseFrame | None = None
    depth_unit: float | None = None

    def __post_init__(self) -> None:
        if self.frame is None and any(pose.X_base_flange is not None for pose in self.poses):
            raise ValueError(
                "X_base_flange without a frame: give `frame: pendant_base` for poses from the teach pendant or RTDE, "
                "`frame: base_link` for ROS's; the two differ by half a turn about z"
            )
        if self.depth_unit is None and any(pose.depth is not None for pose in self.poses):
            raise ValueError("depth images without depth_unit: give the length of one step in metres, such as 0.001")


@dataclass(frozen=True, eq=False)
class Seen:
    """What was found in a session's images.

    Attributes:
        observations: The poses whose image shows the board.
        joints: Joint positions at them, (6,) [rad] each; None where only the flange's pose was given.
        unseen: Names of the images that do not show it.
    """

    observations: list[Observation]
    joints: list[Row | None]
    unseen: list[str]


def read_session(folder: Path) -> Session:
    """Read a session.

    Args:
        folder: Its folder.

    Returns:
        The session.

    Raises:
        ConfigError: It cannot be read, or a field is wrong or missing.
    """
    return read_record(folder / FILE, Session, "calibration session")


def write_session(folder: Path, session: Session) -> None:
    """Write a session's file; its images are there already.

    Args:
        folder: Its folder.
        session: The session.

    Raises:
        UserError: The file cannot be written.
    """
    write_atomic(folder / FILE, (json.dumps(asdict(session), indent=1) + "\n").encode())


def observe(folder: Path, session: Session, board: Board, fk: Callable[[Array], Array]) -> Seen:
    """Find the board in a session's images.

    Args:
        folder: The session's folder.
        session: The session.
        board: The board with its measured square.
        fk: Forward kinematics of this arm: X_base_flange from joint positions.

    Returns:
        The observations.

    Raises:
        UserError: An image is missing, or has another size than the intrinsics say; poses and joint positions disagree
            (`user.calibration_half_turn`), or the depth does not fit.
    """
    observations: list[Observation] = []
    joints: list[Row | None] = []
    unseen: list[str] = []
    for pose in session.poses:
        view = find_board(read_image(folder / pose.image, session.intrinsics), board)
        X = _flange(pose, session, fk)
        if view is None:
            unseen.append(pose.image)
            continue
        depths = None
        if pose.depth is not None and session.depth_unit is not None:
            depth = _depth(folder / pose.depth, session.intrinsics) * session.depth_unit
            column, row = np.round(view.pixels).astype(int).T
            depths = depth[row.clip(0, depth.shape[0] - 1), column.clip(0, depth.shape[1] - 1)]
        observations.append(Observation(pose.image, X, view, depths))
        joints.append(pose.q)
    _check_all_depths(observations, board, session.intrinsics)
    return Seen(observations, joints, unseen)


def _flange(pose: SessionPose, session: Session, fk: Callable[[Array], Array]) -> Array:
    by_joints = None if pose.q is None else fk(np.array(pose.q))
    if pose.X_base_flange is None or session.frame is None:
        assert by_joints is not None
        return by_joints
    given = np.array(pose.X_base_flange, dtype=np.float64)
    check_poses([given], [pose.image])
    X = session.frame.X_base_this @ given
    if by_joints is not None:
        if _agree(X, by_joints):
            return by_joints
        other = next(f for f in BaseFrame if f is not session.frame)
        if _agree(other.X_base_this @ given, by_joints):
            raise UserError(
                f"{pose.image}: the joint positions show that X_base_flange is in {other}, not in {session.frame} "
                f"(half a turn about the base's z). Write `frame: {other}`",
                code="user.calibration_half_turn",
            )
        raise UserError(
            f"{pose.image}: X_base_flange is {np.linalg.norm(X[:3, 3] - by_joints[:3, 3]) * 1e3:.0f} mm from where "
            "the joint positions put the flange. Is a TCP set, or is it another arm's model?"
        )
    return X


def _agree(X: Array, Y: Array) -> bool:
    apart = np.linalg.norm(X[:3, 3] - Y[:3, 3])
    return bool(apart < DISAGREEING[0]) and rotation_angle(X[:3, :3].T @ Y[:3, :3]) < DISAGREEING[1]


def read_image(path: Path, intrinsics: CameraIntrinsics) -> NDArray[np.uint8]:
    """Read an image as grey values.

    Args:
        path: The file.
        intrinsics: Pinhole model of the image.

    Returns:
        The image, (H, W) uint8.

    Raises:
        UserError: It cannot be read, or has another size than the intrinsics say.
    """
    return np.asarray(_checked(path, intrinsics, cv2.IMREAD_GRAYSCALE), np.uint8)


def _depth(path: Path, intrinsics: CameraIntrinsics) -> Array:
    return np.asarray(_checked(path, intrinsics, cv2.IMREAD_UNCHANGED), np.float64)


def _checked(path: Path, intrinsics: CameraIntrinsics, flags: int) -> NDArray[np.generic]:
    try:
        array, why = read_pixels(path, flags), "it is no image"
    except (OSError, ValueError) as error:
        array, why = None, words_of(error)
    if array is None:
        raise UserError(f"cannot read the image {path}: {why}")
    if array.ndim != 2 or array.shape != (intrinsics.height, intrinsics.width):
        raise UserError(
            f"{path} is {array.shape}, but the intrinsics are for {(intrinsics.height, intrinsics.width)} (height, "
            "width). Give the intrinsics of this stream and resolution"
        )
    return array


def _check_all_depths(observations: list[Observation], board: Board, intrinsics: CameraIntrinsics) -> None:
    known = [o for o in observations if o.depths is not None]
    if not known:
        return
    expected = [
        transform_points(camera_board(o.view, board, intrinsics)[0], board.corners[o.view.ids])[:, 2] for o in known
    ]
    check_depths(np.concatenate([o.depths for o in known if o.depths is not None]), np.concatenate(expected))


def build_record(
    calibration: CameraCalibration,
    session: Session,
    seen: Seen,
    board: Board,
    *,
    bars: tuple[float, float] | None,
    robot_model: str,
    kinematics: DhCalibration | None,
    distortion: tuple[float, ...] | None,
    software: str,
    now: datetime,
) -> CalibrationRecord:
    """Build a record.

    Args:
        calibration: The solution.
        session: What was recorded.
        seen: What was found in its images.
        board: The board with its measured square.
        bars: Measured lengths of its scale bars [m], if it was measured so.
        robot_model: Model of the arm.
        kinematics: The arm's factory calibration; None for nominal kinematics.
        distortion: Distortion that the station file states; None for none.
        software: Version of this software.
        now: Date and time.

    Returns:
        The record.
    """
    refined, left_out = calibration.refined, calibration.leave_one_out
    poses = tuple(
        RecordedPose(
            name=o.name,
            q=q,
            X_base_flange=rows(o.X_base_flange),
            ids=tuple(int(i) for i in o.view.ids),
            pixels=rows(np.round(o.view.pixels, 4)),
            reprojection=float(reprojection),
            held_out=float(held_out),
            weight=float(weight),
        )
        for o, q, reprojection, held_out, weight in zip(
            seen.observations, seen.joints, calibration.reprojection, left_out.held_out, refined.weights, strict=True
        )
    )
    x, y, z = calibration.target.tolist()
    return CalibrationRecord(
        format=FORMAT,
        measured_at=now.isoformat(timespec="seconds"),
        software=software,
        robot_model=robot_model,
        robot_serial=session.robot_serial,
        kinematics=kinematics,
        camera_serial=session.camera_serial,
        intrinsics=session.intrinsics,
        board=board,
        bars=bars,
        X_base_camera=rows(refined.estimate.X_base_camera),
        X_flange_board=rows(refined.estimate.X_flange_board),
        covariance=rows(refined.covariance[:6, :6]),
        freedom=refined.freedom,
        pixel_noise=refined.noise.pixel,
        arm_noise=(refined.noise.position, refined.noise.rotation),
        residual=left_out.residual,
        largest_shift=float(left_out.shifts.max()),
        target=(x, y, z),
        target_radius=calibration.target_radius,
        methods=dict(calibration.methods),
        rotations=(calibration.spread.first, calibration.spread.second),
        board_scale=calibration.scale,
        poses=poses,
        distortion=distortion,
    )
