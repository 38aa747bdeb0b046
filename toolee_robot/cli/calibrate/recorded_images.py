"""Recordings as images for a calibration: that of the lens needs raw ones, that of the place undistorted ones."""

from __future__ import annotations

from pathlib import Path

from toolee_robot.devices.cameras.recording import recording_of
from toolee_robot.errors import UserError


def check_raw(what: str, undistorted: bool | None) -> None:
    """Refuse images of a recording, unless it says that their distortion was not taken out.

    Args:
        what: What the images are of, for the error.
        undistorted: Whether they are undistorted; None where nobody knows.

    Raises:
        UserError: They are, or may be (`user.intrinsics_undistorted`).
    """
    if undistorted is False:
        return
    known = "whose images are undistorted" if undistorted else "which does not say whether its images are undistorted"
    remedy = "" if undistorted else "; or, if they are not, add `undistorted: false` to its recording.json"
    raise UserError(
        f"{what} is a recording by `toolee camera record`, {known}: let --station take them from the camera itself, or "
        f"give --images as the lens gives them{remedy}",
        code="user.intrinsics_undistorted",
    )


def check_undistorted(images: Path) -> None:
    """Refuse images of a recording that says that the lens's distortion is still in them.

    Args:
        images: Their folder.

    Raises:
        UserError: It says so (`user.calibration_distorted`).
    """
    recording = recording_of(images)
    if recording is not None and recording.undistorted is False:
        raise UserError(
            f"{recording.folder} says `undistorted: false`: its camera's lens was not known, and the camera's place is "
            "computed from undistorted images. Measure the lens by `toolee calibrate intrinsics --station FILE "
            "--write`, then record again",
            code="user.calibration_distorted",
        )
