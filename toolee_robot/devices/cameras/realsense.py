"""Intel RealSense D400 cameras through the maker's SDK, librealsense (extra `realsense`).

Written from librealsense's documents and its own Python package 2.59, and run against that package's software devices
and recordings; no camera was available.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.devices.cameras.stream import CameraMode, CameraProfile, RawImages
from toolee_robot.errors import NoAnswerError, NotReadyError, UserError
from toolee_robot.frames import transform
from toolee_robot.types import CameraIntrinsics

SILENCE = 1.0
"""Time without any image after which it is asked whether the camera is still there [s]."""
QUEUE = 8
"""Images that the SDK keeps until they are fetched; the oldest are dropped."""
_COLOR_EXPOSURE_UNIT, _STEREO_EXPOSURE_UNIT = 1e-4, 1e-6
"""Units of the exposure of a colour sensor (USB video class) and of a stereo module, which a D405's colour is of [s].
"""


def sdk() -> Any:
    """Import the SDK.

    Raises:
        UserError: It is not installed, or lacks a library of the system.
    """
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        raise UserError(
            f"the RealSense driver needs pyrealsense2 ({error}): run `python -m pip install -e '.[realsense]'`, and "
            "install the system's libusb-1.0 (Debian: libusb-1.0-0)",
            code="user.missing_package",
        ) from error


def connected() -> list[Any]:
    """The RealSense devices of this computer, as `pyrealsense2.device`."""
    return list(sdk().context().query_devices())


def describe_connected(devices: Callable[[], Sequence[Any]] = connected) -> list[dict[str, str]]:
    """Describe the connected cameras.

    Args:
        devices: Where they are looked for.

    Returns:
        Model, serial number, firmware and kind of port of each.

    Raises:
        UserError: The SDK is not installed.
    """
    info = sdk().camera_info
    return [
        {
            "model": _info(device, info.name),
            "serial": _info(device, info.serial_number),
            "firmware": _info(device, info.firmware_version),
            "port": f"USB {usb}" if (usb := _info(device, info.usb_type_descriptor)) else "",
        }
        for device in devices()
    ]


class RealSenseStream:
    """The `CameraStream` of a RealSense.

    The depth stays as the stereo module gives it; `StreamedCamera` registers it. Colour and depth are paired by their
    stamps.

    Args:
        serial: The camera's serial number.
        mode: Size, rate and exposure.
        devices: Where the camera is looked for, again when it falls silent.
    """

    def __init__(self, serial: str, mode: CameraMode, devices: Callable[[], Sequence[Any]] = connected) -> None:
        self._serial, self._mode, self._devices = serial, mode, devices
        self._sensors: list[Any] = []

    def open(self) -> CameraProfile:
        """Find the camera, start both streams and read its calibration.

        Raises:
            UserError: The SDK is not installed.
            NoAnswerError: No camera with this serial number is connected, or it cannot be opened.
            NotReadyError: It does not have the mode, the exposure or a known lens.
        """
        rs = self._rs = sdk()
        device = self._find()
        if device is None:
            others = ", ".join(_info(other, rs.camera_info.serial_number) for other in self._devices())
            raise NoAnswerError(
                f"no RealSense with serial number {self._serial} is connected (there are: {others or 'none'}): check "
                "cable and camera.device.serial",
                code="no_answer.camera_missing",
            )
        try:
            return self._start(rs, device)
        except RuntimeError as error:  # the SDK's only exception
            self.close()
            raise NoAnswerError(
                f"the RealSense {self._serial} cannot be opened ({error}): close other programs that use it, or plug "
                "it in again"
            ) from error
        except BaseException:
            self.close()
            raise

    def _start(self, rs: Any, device: Any) -> CameraProfile:
        color_sensor, color = self._choose(device, rs.stream.color, rs.format.rgb8)
        depth_sensor, depth = self._choose(device, rs.stream.depth, rs.format.z16)
        self._set_exposure(rs, color_sensor)
        extrinsics = depth.get_extrinsics_to(color)
        R = np.array(extrinsics.rotation, np.float64).reshape(3, 3, order="F")
        auto = rs.option.enable_auto_exposure
        profile = CameraProfile(
            model=_info(device, rs.camera_info.name),
            serial=self._serial,
            color=self._lens(rs, color),
            fps=float(self._mode.fps),
            depth=self._lens(rs, depth),
            X_color_depth=transform(R, extrinsics.translation),
            depth_scale=float(depth_sensor.get_option(rs.option.depth_units)),
            auto_exposure=bool(color_sensor.get_option(auto)) if color_sensor.supports(auto) else None,
            firmware=_info(device, rs.camera_info.firmware_version),
        )
        self._queue = rs.frame_queue(QUEUE)
        self._color: Any = None
        self._depth: Any = None
        self._heard = time.monotonic()
        same = color_sensor is depth_sensor
        for sensor, profiles in (
            [(depth_sensor, [depth, color])]
            if same
            else [
                (depth_sensor, [depth]),
                (color_sensor, [color]),
            ]
        ):
            sensor.open(profiles)
            self._sensors.append(sensor)
            sensor.start(self._queue)
        return profile

    def fetch(self, timeout: float) -> RawImages | None:
        """Wait for the next pair.

        Args:
            timeout: Longest wait [s].

        Returns:
            The pair; None if none came.

        Raises:
            NoAnswerError: The camera is gone.
        """
        end = time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0:
            came, frame = self._queue.try_wait_for_frame(max(1, int(left * 1e3)))
            if not came:
                self._check_connected()
                continue
            self._heard = time.monotonic()
            kind = frame.profile.stream_type()
            if kind == self._rs.stream.color:
                self._color = frame
            elif kind == self._rs.stream.depth:
                self._depth = frame
            if (pair := self._paired()) is not None:
                return pair
        return None

    def close(self) -> None:
        """Stop both streams."""
        for sensor in self._sensors:
            for end in (sensor.stop, sensor.close):
                try:
                    end()
                except RuntimeError:  # it is gone, or was not started
                    continue
        self._sensors = []
        self._color = self._depth = None

    def _paired(self) -> RawImages | None:
        """The two images that are held, if they are of one time; of two that are not, the older one is dropped."""
        color, depth = self._color, self._depth
        if color is None or depth is None:
            return None
        if color.get_frame_timestamp_domain() != depth.get_frame_timestamp_domain():
            raise NotReadyError(
                "the RealSense stamps colour and depth by different clocks: update its firmware, and on Linux the "
                "kernel's uvcvideo patch for metadata"
            )
        apart = 1e-3 * (color.get_timestamp() - depth.get_timestamp())
        if abs(apart) > 0.5 / self._mode.fps:
            if apart < 0:
                self._color = None
            else:
                self._depth = None
            return None
        self._color = self._depth = None
        return RawImages(
            np.array(color.get_data(), np.uint8),
            np.array(depth.get_data(), np.uint16),
            1e-3 * color.get_timestamp(),
            1e-3 * depth.get_timestamp(),
        )

    def _check_connected(self) -> None:
        if time.monotonic() - self._heard > SILENCE:
            if self._find() is None:
                message = f"the RealSense {self._serial} is unplugged: plug it in, and open it again"
                raise NoAnswerError(message, code="no_answer.camera_unplugged")
            self._heard = time.monotonic()

    def _find(self) -> Any | None:
        number = self._rs.camera_info.serial_number
        found = (d for d in self._devices() if d.is_connected() and _info(d, number) == self._serial)
        return next(found, None)

    def _choose(self, device: Any, stream: Any, layout: Any) -> tuple[Any, Any]:
        """The sensor and the mode of a stream: for the depth the size next to the colour's."""
        rs, mode = self._rs, self._mode
        modes = [
            (sensor, profile.as_video_stream_profile())
            for sensor in device.query_sensors()
            for profile in sensor.get_stream_profiles()
            if profile.stream_type() == stream and profile.format() == layout and profile.fps() == mode.fps
        ]
        if stream == rs.stream.color:
            fitting = [m for m in modes if (m[1].width(), m[1].height()) == (mode.width, mode.height)]
        else:
            fitting = sorted(modes, key=lambda m: abs(m[1].width() * m[1].height() - mode.width * mode.height))
        if not fitting:
            has = ", ".join(sorted({f"{p.width()}x{p.height()}" for _, p in modes})) or "none"
            raise NotReadyError(
                f"the RealSense has no {stream.name} image of {mode.width}x{mode.height} at {mode.fps} Hz (sizes at "
                f"this rate: {has}). Choose another size or rate, and a USB 3 port"
            )
        return fitting[0]

    def _set_exposure(self, rs: Any, sensor: Any) -> None:
        auto, exposure = rs.option.enable_auto_exposure, rs.option.exposure
        if self._mode.exposure is None:
            if sensor.supports(auto):
                _set(sensor, auto, 1.0)
            return
        unit = _STEREO_EXPOSURE_UNIT if sensor.is_depth_sensor() else _COLOR_EXPOSURE_UNIT
        if not (sensor.supports(auto) and sensor.supports(exposure)):
            message = "this RealSense's exposure cannot be set: leave out camera.device.exposure"
            raise NotReadyError(message)
        allowed, value = sensor.get_option_range(exposure), round(self._mode.exposure / unit)
        if not allowed.min <= value <= allowed.max:
            raise NotReadyError(
                f"an exposure of {self._mode.exposure:g} s is outside this camera's range: give "
                f"camera.device.exposure from {allowed.min * unit:g} to {allowed.max * unit:g}"
            )
        _set(sensor, auto, 0.0)
        _set(sensor, exposure, float(value))

    def _lens(self, rs: Any, profile: Any) -> Lens:
        found = profile.get_intrinsics()
        pinhole = CameraIntrinsics(found.fx, found.fy, found.ppx, found.ppy, found.width, found.height)
        if not any(found.coeffs):
            return Lens(pinhole)
        models = {
            rs.distortion.none: LensModel.NONE,
            rs.distortion.brown_conrady: LensModel.BROWN_CONRADY,
            rs.distortion.modified_brown_conrady: LensModel.MODIFIED_BROWN_CONRADY,
            # As rsutil.h computes it: its documents say that it undistorts, its code that it distorts.
            rs.distortion.inverse_brown_conrady: LensModel.MODIFIED_BROWN_CONRADY,
        }
        if found.model not in models:
            message = f"this RealSense's lens is {found.model}, which the driver does not know: use another mode"
            raise NotReadyError(message, code="not_ready.camera_lens")
        return Lens(pinhole, models[found.model], tuple(map(float, found.coeffs)))


def _set(sensor: Any, option: Any, value: float) -> None:
    if sensor.get_option(option) != value:  # of a recording no option can be written
        sensor.set_option(option, value)


def _info(device: Any, what: Any) -> str:
    return str(device.get_info(what)) if device.supports(what) else ""
