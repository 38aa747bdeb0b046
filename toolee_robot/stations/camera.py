"""The camera of a real station: the driver that its station file names.

with open_camera(load_lab_station(Path("lab.yaml")).camera, HostClock()) as camera:
    frame = camera.read()
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from toolee_robot.devices.cameras import CameraProfile, CameraStream, RawImages, StatedLens, StreamedCamera
from toolee_robot.devices.cameras.airo import AiroStream
from toolee_robot.devices.cameras.orbbec import OrbbecStream
from toolee_robot.devices.cameras.realsense import RealSenseStream
from toolee_robot.devices.cameras.recording import RecordedStream
from toolee_robot.devices.cameras.stream import CameraMode
from toolee_robot.errors import ConfigError, NotReadyError, UserError, words_of
from toolee_robot.hal import Clock
from toolee_robot.runtime.device_plugins import installed, load
from toolee_robot.station import CameraConfig, CameraDevice

REALSENSE, ORBBEC, AIRO, RECORDED = "realsense", "orbbec", "airo", "recorded"
"""Names of drivers: of a camera whose SDK has software devices, of another one, of those of airo-camera-toolkit, and of
recordings, which see nothing new."""
WITH_MODE = (REALSENSE, ORBBEC, AIRO)
"""Drivers that open the camera in the mode that the station file names: camera.width and height, camera.device.fps."""
WITH_LENS = (REALSENSE, ORBBEC)
"""Those whose cameras tell the distortion of their lens, too."""
CLASS_ARGUMENTS = ("resolution", "fps", "serial_number")
"""What a class of airo-camera-toolkit must take: size (width, height) [px], frames per second, and serial number."""
CLASS_SETTINGS = {"enable_pointcloud": False, "enable_hole_filling": False}
"""What it is given, too, if it takes it: no point cloud, which nobody reads, and no depth that was not measured."""
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
            gives what another one needs.
        UserError: airo-camera-toolkit is not installed.
    """
    device = config.device
    if device is None:
        raise ConfigError(
            "camera.device is missing: give camera.device.driver, .serial and .least_range; `toolee camera list` shows "
            "the cameras of this computer"
        )
    if stream is None:
        driver = _driver(device.driver)
        if device.camera_class is not None and device.driver != AIRO:
            message = f"camera.device.camera_class is for the driver {AIRO}, not {device.driver}: leave it out"
            raise ConfigError(message)
        stream = driver(config, device, clock)
    measured = config.intrinsics_record is not None
    stated = StatedLens(config.intrinsics, config.distortion, measured) if check_intrinsics else None
    return StreamedCamera(_OfSerial(stream, device.serial), clock, stated)


def camera_drivers() -> dict[str, str]:
    """The drivers that a station file may name, and where each is from: this project, or an installed package."""
    others = {name: entry.value for name, entry in installed("camera").items()}
    return others | dict.fromkeys(_DRIVERS, "toolee_robot")


def toolkit_camera(name: str, serial: str, size: tuple[int, int], fps: int) -> Callable[[], Any]:
    """Look up a camera class of airo-camera-toolkit, or one that is derived from it.

    Args:
        name: Module and class, such as airo_camera_toolkit.cameras.zed.zed.Zed.
        serial: Serial number of the camera.
        size: Width and height of the colour image [px].
        fps: Frames per second.

    Returns:
        What constructs the camera, which opens it.

    Raises:
        UserError: The toolkit is not installed (`user.missing_package`).
        ConfigError: The class cannot be imported, is no RGB-D camera of the toolkit, or cannot be told which camera to
            open and how; or the serial number of a ZED is no number.
    """
    try:
        base = importlib.import_module("airo_camera_toolkit.interfaces").RGBDCamera
    except (ImportError, OSError) as error:  # OSError: what its Open3D asks of the system is missing
        raise UserError(
            f"the driver airo needs airo-camera-toolkit ({words_of(error)}). Install it as docs/start/install.md "
            "says, because its OpenCV would replace this project's",
            code="user.missing_package",
        ) from error
    kind = _class_of(name, base)
    taken = inspect.signature(kind).parameters
    if lacking := [argument for argument in CLASS_ARGUMENTS if argument not in taken]:
        raise _refused(name, f"takes no {', '.join(lacking)}: name a class that does, or derive one")
    given: dict[str, Any] = {"resolution": size, "fps": fps, "serial_number": serial}
    given |= {argument: value for argument, value in CLASS_SETTINGS.items() if argument in taken}
    if "depth_mode" in taken:  # a ZED: without it there is no depth, and its SDK takes the serial number as an integer
        if not serial.isdecimal():
            message = f"camera.device.serial: {serial!r} is not a ZED's serial number, which has digits only"
            raise ConfigError(message)
        given |= {"depth_mode": kind.InitParams.NEURAL_DEPTH_MODE, "serial_number": int(serial)}
    return lambda: kind(**given)


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


class _OfSerial:
    """A stream that is refused where it is another camera's."""

    def __init__(self, stream: CameraStream, serial: str) -> None:
        self._stream, self._serial = stream, serial
        self.fetch: Callable[[float], RawImages | None] = stream.fetch
        self.close: Callable[[], None] = stream.close

    def open(self) -> CameraProfile:
        profile = self._stream.open()
        if profile.serial != self._serial:
            self._stream.close()
            raise NotReadyError(
                f"the camera's serial number is {profile.serial!r}, the station file's {self._serial!r}: connect the "
                "calibrated camera, or calibrate this one and change camera.device.serial",
                code="not_ready.camera_serial",
            )
        return profile


def _class_of(name: str, base: type) -> Any:
    module, _, attribute = name.rpartition(".")
    try:
        kind = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # whatever the import of a maker's library raises
        raise _refused(name, f"cannot be imported: {words_of(error)}") from error
    if not (inspect.isclass(kind) and issubclass(kind, base)) or inspect.isabstract(kind):
        raise _refused(name, "is no RGB-D camera of airo-camera-toolkit: name a class derived from its RGBDCamera")
    return kind


def _refused(name: str, why: str) -> ConfigError:
    return ConfigError(f"camera.device.camera_class {name!r} {why}")


def _realsense(config: CameraConfig, device: CameraDevice, _clock: Clock) -> CameraStream:
    return RealSenseStream(device.serial, CameraMode(config.width, config.height, device.fps, device.exposure))


def _orbbec(config: CameraConfig, device: CameraDevice, _clock: Clock) -> CameraStream:
    _refuse_exposure(device)
    return OrbbecStream(device.serial, CameraMode(config.width, config.height, device.fps))


def _airo(config: CameraConfig, device: CameraDevice, _clock: Clock) -> CameraStream:
    _refuse_exposure(device)
    if device.camera_class is None:
        raise ConfigError(
            "camera.device.camera_class is missing. Give the class of airo-camera-toolkit for the camera, such as "
            "airo_camera_toolkit.cameras.zed.zed.Zed"
        )
    make = toolkit_camera(device.camera_class, device.serial, (config.width, config.height), device.fps)
    return AiroStream(make, device.serial)


def _refuse_exposure(device: CameraDevice) -> None:
    if device.exposure is not None:
        message = "camera.device.exposure: this driver does not set it; do so in the maker's viewer, and leave it out"
        raise ConfigError(message)


def _recorded(_config: CameraConfig, device: CameraDevice, clock: Clock) -> CameraStream:
    if device.folder is None:
        message = "camera.device.folder is missing: the folder of a recording by `toolee camera record`"
        raise ConfigError(message)
    return RecordedStream(Path(device.folder), clock)


_DRIVERS: dict[str, CameraDriver] = {REALSENSE: _realsense, ORBBEC: _orbbec, AIRO: _airo, RECORDED: _recorded}
