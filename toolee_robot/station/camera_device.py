"""The camera of a real station: which driver opens which device, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from toolee_robot.station.values import STRICT
from toolee_robot.types.units import Metres, Seconds, Unit


@dataclass(frozen=True)
class CameraDevice:
    """The camera as its driver opens it. Size and intrinsics are those of `camera`."""

    __pydantic_config__ = STRICT
    driver: str
    """Name of the driver, one of those that `toolee devices list` prints."""
    serial: str
    """Serial number of the camera; a calibration holds for this camera alone."""
    least_range: Annotated[float, Metres(0.01, 5.0)]
    """Least depth that the camera measures in this mode, from its data sheet; the views of a job must be beyond it.
    """
    fps: Annotated[int, Unit("1/s", 1, 300)] = 30
    """Frames per second of colour and depth."""
    exposure: Annotated[float, Seconds(0.00002, 1.0)] | None = None
    """Exposure of the colour image; null lets the camera choose it, differently in each view."""
    folder: str | None = None
    """Folder of the recording, for the driver `recorded`."""
    camera_class: str | None = None
    """Class of airo-camera-toolkit that opens the camera, with its module, for the driver `airo`, such as
    airo_camera_toolkit.cameras.zed.zed.Zed."""
