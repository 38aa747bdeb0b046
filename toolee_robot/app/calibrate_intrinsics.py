"""The calibration of a camera's intrinsics: views, solution, record, and its entry in the station file."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import toolee_robot
from toolee_robot.app.sources import Listener, Waiting
from toolee_robot.calibration.board import SHEETS, Board
from toolee_robot.calibration.intrinsics import calibrate_intrinsics, read_views
from toolee_robot.calibration.observation import BoardView
from toolee_robot.calibration.record import IntrinsicsRecord, read_intrinsics
from toolee_robot.devices.cameras import StreamedCamera
from toolee_robot.devices.cameras.recording import recording_of
from toolee_robot.errors import ConfigError, DeviceError, StaleDataError, UserError
from toolee_robot.hal import Clock
from toolee_robot.runtime.clock import HostClock
from toolee_robot.runtime.yaml_files import to_record
from toolee_robot.station import CameraConfig, read_station, write_measured
from toolee_robot.station.camera_files import CAMERA, INTRINSICS, PINHOLE
from toolee_robot.stations.camera import WITH_MODE, open_camera
from toolee_robot.tasks.calibration.collect import HandHeldViews, Offered

PATIENCE = 120.0
"""Time without a new view after which nobody is taken to hold the board [s]."""
IMAGE_TIME = 2.0
"""Longest wait for an image [s]."""
NOMINAL_FOCAL = 0.72
"""Focal length of a camera of which the file says none yet, in widths of the image."""
ANY_PLACE = {"position": [1.0, 0.0, 1.0], "target": [0.0, 0.0, 0.0]}
"""A place of the camera, which its intrinsics do not depend on [m]."""


@dataclass(frozen=True)
class IntrinsicsJob:
    """A calibration of a camera's intrinsics.

    Attributes:
        sheet: Name of the board's sheet.
        listener: Who hears of it.
        bell: Is called with each view that is taken.
    """

    sheet: str
    listener: Listener
    bell: Callable[[], None] = lambda: None

    def from_images(self, images: Path, bars: tuple[float, float], serial: str) -> IntrinsicsRecord:
        """Calibrate from a folder of images.

        Args:
            images: The folder.
            bars: Measured lengths of the print's scale bars [m].
            serial: Serial number of the camera.

        Returns:
            The record.

        Raises:
            UserError: As `calibrate_intrinsics` and `read_views`; or the images are undistorted, or may be.
        """
        if (recording := recording_of(images)) is not None:
            _check_raw(str(images), recording.undistorted)
        board = SHEETS[self.sheet].board.measured(*bars)
        views, unseen, size = read_views(images, board)
        if unseen:
            self.listener.warn(f"the board is not seen in {', '.join(unseen)}")
        return self._solve(views, board, size, serial)

    def live(self, camera: CameraConfig, count: int, bars: tuple[float, float]) -> IntrinsicsRecord:
        """Calibrate a camera with a board that somebody holds before it.

        Args:
            camera: The camera.
            count: Number of views.
            bars: Measured lengths of the print's scale bars [m].

        Returns:
            The record.

        Raises:
            DeviceError: The camera failed.
            UserError: As `calibrate_intrinsics`; or the camera is a recording whose images are undistorted, or may be.
        """
        board, clock = SHEETS[self.sheet].board.measured(*bars), HostClock()
        with open_camera(camera, clock, check_intrinsics=False) as opened:
            _check_raw("camera.device", opened.profile.undistorted)
            return self.collect(opened, clock, board, count, opened.profile.serial)

    def collect(self, camera: StreamedCamera, clock: Clock, board: Board, count: int, serial: str) -> IntrinsicsRecord:
        """Take views of a board that somebody holds before a camera, and solve.

        Args:
            camera: The camera, opened.
            clock: The station's clock.
            board: The board, as measured.
            count: Number of views.
            serial: Serial number for the record.

        Returns:
            The record.

        Raises:
            UserError: As `calibrate_intrinsics`.
        """
        k = camera.profile.color.intrinsics
        views = HandHeldViews(board, (k.width, k.height), count)
        self.listener.say(
            f"[bold]Views[/bold]  [dim]{count} wanted, in all corners of the image, tilted by 30 to 45°. Hold the "
            "board still until it is counted, then change it. Ctrl-C ends[/dim]"
        )
        try:
            with self.listener.waiting("looking") as waiting:
                self._take(camera, clock, views, waiting)
        except (KeyboardInterrupt, DeviceError) as end:  # the views so far cost a person's time
            self.listener.warn(f"ended before all views were taken. {end}")
        return self._solve(views.views, board, (k.width, k.height), serial)

    def _take(self, camera: StreamedCamera, clock: Clock, views: HandHeldViews, waiting: Waiting) -> None:
        stamp, last = 0.0, clock.now()
        while not views.complete:
            try:
                rgb, stamp = camera.distorted(stamp, IMAGE_TIME)
            except StaleDataError:
                if clock.now() - last > PATIENCE:
                    raise
                continue
            offered = views.offer(rgb)
            waiting.update(str(offered))
            if offered is Offered.TAKEN:
                last = clock.now()
                self.bell()
                lacking = f"; not yet in the {', '.join(views.lacking)}" if views.lacking else ""
                self.listener.say(
                    f"  {len(views.views):>3}  {len(views.views[-1].ids)} corners; {100 * views.covered:.0f} % of the "
                    f"image{lacking}"
                )
            elif clock.now() - last > PATIENCE:
                raise UserError(
                    f"no new view within {PATIENCE:.0f} s ({offered}). Hold the board in front of the camera"
                )

    def _solve(self, views: list[BoardView], board: Board, size: tuple[int, int], serial: str) -> IntrinsicsRecord:
        with self.listener.waiting("solving"):
            return calibrate_intrinsics(
                views,
                board,
                size,
                camera_serial=serial,
                software=toolee_robot.__version__,
                measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
            )


def _check_raw(what: str, undistorted: bool | None) -> None:
    """Refuse images of a recording, unless it says that their distortion was not taken out; None: nobody knows."""
    if undistorted is False:
        return
    known = "whose images are undistorted" if undistorted else "which does not say whether its images are undistorted"
    remedy = "" if undistorted else ". If they are not, add `undistorted: false` to its recording.json"
    raise UserError(
        f"{what} is a recording by `toolee camera record`, {known}. Let --station take them from the camera itself, "
        f"or give --images as the lens gives them{remedy}"
    )


def camera_of(path: Path) -> CameraConfig:
    """Read which camera a station file names, whatever the file says of its intrinsics.

    A record that was lost or altered is passed over: this measurement replaces it.

    Args:
        path: The station file.

    Returns:
        The camera: its device and size, its pinhole as far as the file tells it, and no distortion.

    Raises:
        ConfigError: The file cannot be read, names no device, or leaves out the size that the
            driver asks the device for.
    """
    camera = _camera(path)
    kept = {name: camera[name] for name in ("device", *PINHOLE) if camera.get(name) is not None}
    lost = ""
    if isinstance(name := camera.get(INTRINSICS), str):
        try:
            known = read_intrinsics(path.parent / name).intrinsics
            kept = {**{field: getattr(known, field) for field in PINHOLE}, **kept}
        except ConfigError as error:
            lost = f"; the record in camera.{INTRINSICS} cannot be read ({error})"
    if not isinstance(device := kept.get("device"), dict):
        raise ConfigError(
            f"{path}: camera.device is missing: give camera.device.driver, .serial and .least_range; `toolee camera "
            "list` shows the cameras of this computer"
        )
    if "width" not in kept or "height" not in kept:
        if device.get("driver") in WITH_MODE:
            raise ConfigError(
                f"{path}: give camera.width and camera.height, a size that the camera has, because intrinsics "
                f"belong to one size{lost}"
            )
    elif not kept.keys() >= {*PINHOLE}:
        width, height = float(kept["width"]), float(kept["height"])
        focal = NOMINAL_FOCAL * width
        kept = {"fx": focal, "fy": focal, "cx": (width - 1) / 2, "cy": (height - 1) / 2, **kept}
    return to_record({**ANY_PLACE, **kept}, path, CameraConfig, "station's camera")


def check_entry(path: Path) -> None:
    """Refuse, before anything is measured, what could not be entered.

    Args:
        path: The station file.

    Raises:
        UserError: The file names a calibration of the camera's place, which holds with the intrinsics of then only.
    """
    if read_station(path).get("calibration"):
        raise UserError(
            f"{path} names a calibration of the camera's pose, which needs the intrinsics it was made with. Delete "
            "its section `calibration` (of measured.yaml, if a command wrote it), measure the intrinsics, then "
            "calibrate the pose again"
        )


def enter(path: Path, record_file: Path) -> None:
    """Enter a record in `measured.yaml` beside a station file; it holds instead of the numbers that the file gives.

    Args:
        path: The station file.
        record_file: The record's file.

    Raises:
        ConfigError: The station would be refused with it; nothing was written.
    """
    write_measured(path, camera={INTRINSICS: os.path.relpath(record_file, path.parent)})


def _camera(path: Path) -> dict[str, Any]:
    data = read_station(path)
    camera = data.get(CAMERA) if isinstance(data, dict) else None
    return camera if isinstance(camera, dict) else {}
