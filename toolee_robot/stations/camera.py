"""The camera of a real station: the driver that its station file names.

with open_camera(load_lab_station(Path("lab.yaml")).camera, HostClock()) as camera:
    frame = camera.read()
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from toolee_robot.devices.cameras import CameraStream, StatedLens, StreamedCamera
from toolee_robot.devices.cameras.orbbec import OrbbecStream
from toolee_robot.devices.cameras.realsense import RealSenseStream
from toolee_robot.devices.cameras.recording import RecordedStream
from toolee_robot.devices.cameras.stream import CameraMode
from toolee_robot.errors import ConfigError
from toolee_robot.hal import Clock
from toolee_robot.runtime.device_plugins import installed, load
from toolee_robot.station import CameraConfig, CameraDevice

REALSENSE, ORBBEC, RECORDED = "realsense", "orbbec", "recorded"
"""Names of drivers: of a camera whose SDK has software devices, of another one, and of recordings, which see nothing
new."""
WITH_MODE = (REALSENSE, ORBBEC)
"""Drivers that open the camera in the mode that the station file names (camera.width and height, camera.device.fps).
The camera tells the distortion of its lens, too."""
CameraDriver = Callable[[CameraConfig, CameraDevice, Clock], CameraStream]
"""What makes a driver's stream: from the station file's `camera`, its `camera.device`, and the station's clock."""


def open_camera(
    config: CameraConfig, clock: Clock, *, check_intrinsics: bool = True, stream: CameraStream | None = None
) -> StreamedCamera:
    """Build the driver of a station's camera.

    Args:
        config: What the station file says of the camera.
        clock: The station's clock, the host's.
        check_intrinsics: Whether the lens is chosen and checked by what the station file states (`choose_lens`); not so
            where the camera itself is asked for its intrinsics.
        stream: The camera's stream instead of its driver's, for an emulated camera.

    Returns:
        The camera, not yet entered. Entering it raises what `StreamedCamera` raises, and a NotReadyError where the
        camera reports another serial number.

    Raises:
        ConfigError: The station file names no camera, or a driver that is not there, or lacks what the driver needs, or
            gives what the driver does not set.
    """
    device = config.device
    if device is None:
        raise ConfigError(
            "camera.device is missing: give camera.device.driver, .serial and .least_range; `toolee camera list` shows "
            "the cameras of this computer"
        )
    if stream is None:
        stream = _driver(device.driver)(config, device, clock)
    stated = StatedLens(config.intrinsics, config.distortion) if check_intrinsics else None
    return StreamedCamera(stream, clock, stated, device.serial)


def camera_drivers() -> dict[str, str]:
    """The drivers that a station file may name, and where each is from: this project, or an installed package."""
    others = {name: entry.value for name, entry in installed("camera").items()}
    return others | dict.fromkeys(_DRIVERS, "toolee_robot")


def _driver(name: str) -> CameraDriver:
    if name in _DRIVERS:
        return _DRIVERS[name]
    others = installed("camera")
    if name not in others:
        known = ", ".join(sorted({*_DRIVERS, *others}))
        message = f"camera.device.driver {name!r} is unknown. Known drivers: {known}; docs/how-to/add_a_camera.md"
        raise ConfigError(message)
    driver: CameraDriver = load(others[name])
    return driver


def _realsense(config: CameraConfig, device: CameraDevice, _clock: Clock) -> CameraStream:
    return RealSenseStream(device.serial, CameraMode(config.width, config.height, device.fps, device.exposure))


def _orbbec(config: CameraConfig, device: CameraDevice, _clock: Clock) -> CameraStream:
    if device.exposure is not None:
        message = "camera.device.exposure: this driver does not set it; do so in the maker's viewer, and leave it out"
        raise ConfigError(message)
    return OrbbecStream(device.serial, CameraMode(config.width, config.height, device.fps))


def _recorded(_config: CameraConfig, device: CameraDevice, clock: Clock) -> CameraStream:
    if device.folder is None:
        message = "camera.device.folder is missing: the folder of a recording by `toolee camera record`"
        raise ConfigError(message)
    return RecordedStream(Path(device.folder), clock)


_DRIVERS: dict[str, CameraDriver] = {REALSENSE: _realsense, ORBBEC: _orbbec, RECORDED: _recorded}
