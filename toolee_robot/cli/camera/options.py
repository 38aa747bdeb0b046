"""Options that the `toolee camera` commands share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from toolee_robot.cli.options import Flag
from toolee_robot.errors import UserError
from toolee_robot.station import CameraConfig, CameraDevice, load_station

if TYPE_CHECKING:
    from toolee_robot.devices.cameras import StreamedCamera
    from toolee_robot.hal import Clock

UNKNOWN_RANGE = 1e-3
"""Stands in for the least range of a camera that no station file describes, where nothing asks for it [m]."""


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Which camera: a station file's, a recording, or one by driver and serial number."""

    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """The station file, whose camera.device is opened."""
    recording: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Instead: a recording of `toolee camera record`, played."""
    driver: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Instead: the name of a driver, such as realsense, with --serial."""
    serial: Annotated[str | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = None
    """Serial number of the camera."""
    camera_class: Annotated[str | None, tyro.conf.arg(metavar="MODULE.CLASS", help_behavior_hint="")] = None
    """With --driver airo: the class of airo-camera-toolkit that opens the camera."""
    size: Annotated[tuple[int, int], tyro.conf.arg(metavar="W H")] = (848, 480)
    """With --driver: size of the colour image [px]."""
    fps: int = 30
    """With --driver: frames per second."""
    exposure: Annotated[float | None, tyro.conf.arg(metavar="S", help_behavior_hint="")] = None
    """With --driver: exposure of the colour image [s]; without, the camera chooses it."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def camera(self) -> CameraConfig:
        """What the station file, or the options, say of the camera.

        Raises:
            UserError: The options name none, or more than one.
            ConfigError: The station file is invalid.
        """
        given = [self.config is not None, self.recording is not None, self.driver is not None]
        if sum(given) != 1:
            message = "which camera? give one of --config YAML, --recording DIR, or --driver NAME with --serial NUMBER"
            raise UserError(message, code="user.option")
        if self.config is not None:
            return load_station(self.config).camera
        if self.recording is not None:
            from toolee_robot.devices.cameras.recording import open_recording

            recording = open_recording(self.recording)
            device = CameraDevice("recorded", recording.serial, UNKNOWN_RANGE, folder=str(self.recording))
            return CameraConfig(device=device)
        if self.driver is None or self.serial is None:
            raise UserError("--driver without --serial: `toolee camera list` shows them", code="user.option")
        device = CameraDevice(
            self.driver, self.serial, UNKNOWN_RANGE, self.fps, self.exposure, camera_class=self.camera_class
        )
        return replace(CameraConfig(device=device), width=self.size[0], height=self.size[1])

    def open(self, clock: Clock, *, own_lens: bool = False) -> StreamedCamera:
        """The camera, not yet entered: by the station file's lens where it states a distortion, else by its own.

        Args:
            clock: The station's clock.
            own_lens: Whether the camera's own lens is taken, whatever the station file states.

        Returns:
            The camera.

        Raises:
            UserError: As `camera`.
            ConfigError: As `camera`, and as `stations.camera.open_camera`.
        """
        from toolee_robot.stations.camera import open_camera

        config = self.camera()
        return open_camera(config, clock, check_intrinsics=config.distortion is not None and not own_lens)
