"""Orbbec cameras (Femto Bolt and Mega, Gemini 330) through the maker's SDK, OrbbecSDK 2 (pyorbbecsdk2).

Written from the SDK's sources and its Python package 2.1.2, and run against that package's playback device, on a
recording in the SDK's format that this project writes; no camera was available.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.devices.cameras.stream import CameraMode, CameraProfile, RawImages
from toolee_robot.errors import NoAnswerError, NotReadyError, UserError
from toolee_robot.frames import transform
from toolee_robot.types import CameraIntrinsics

SILENCE = 1.0
"""Time without any pair after which it is asked whether the camera is still there [s]."""
START_TIME = 5.0
"""Time for the first pair, which tells the unit of the depth [s]."""


def sdk() -> Any:
    """Import the SDK; it writes no log.

    Raises:
        UserError: It is not installed.
    """
    try:
        with _printing_to_stderr():
            ob = importlib.import_module("pyorbbecsdk")
    except ImportError as error:
        raise UserError(
            f"the Orbbec driver needs pyorbbecsdk2 ({error}): run `python -m pip install --no-deps pyorbbecsdk2`. "
            "Its own dependencies are viewers, and an OpenCV that would replace this project's",
            code="user.missing_package",
        ) from error
    ob.Context.set_logger_to_file(ob.OBLogLevel.NONE, "")
    ob.Context.set_logger_level(ob.OBLogLevel.NONE)
    return ob


@contextlib.contextmanager
def _printing_to_stderr() -> Iterator[None]:
    """Have what C code prints on standard output, as the SDK's import does, on standard error."""
    sys.stdout.flush()
    flush = ctypes.CDLL(None).fflush
    kept = os.dup(1)
    try:
        flush(None)
        os.dup2(2, 1)
        yield
        flush(None)
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def connected() -> dict[str, Callable[[], Any]]:
    """The connected cameras: by serial number, what opens each as a `pyorbbecsdk.Device`."""
    devices = sdk().Context().query_devices()
    return {
        devices.get_device_serial_number_by_index(i): partial(devices.get_device_by_index, i)
        for i in range(devices.get_count())
    }


def describe_connected() -> list[dict[str, str]]:
    """Describe the connected cameras, without opening them.

    Returns:
        Model, serial number, firmware (which is not told so) and kind of port of each.

    Raises:
        UserError: The SDK is not installed.
    """
    devices = sdk().Context().query_devices()
    return [
        {
            "model": devices.get_device_name_by_index(i),
            "serial": devices.get_device_serial_number_by_index(i),
            "firmware": "",
            "port": devices.get_device_connection_type_by_index(i),
        }
        for i in range(devices.get_count())
    ]


class OrbbecStream:
    """The `CameraStream` of an Orbbec camera. The exposure stays as it was set by the maker's program.

    Args:
        serial: The camera's serial number.
        mode: Size and rate.
        cameras: Where it is looked for, again when it falls silent.
    """

    def __init__(
        self, serial: str, mode: CameraMode, cameras: Callable[[], Mapping[str, Callable[[], Any]]] = connected
    ) -> None:
        self._serial, self._mode, self._cameras = serial, mode, cameras
        self._pipeline: Any = None
        self._device: Any = None

    def open(self) -> CameraProfile:
        """Find the camera, start both streams and read its calibration.

        Raises:
            UserError: The SDK is not installed.
            NoAnswerError: No camera with this serial number is connected, it cannot be opened, or gives no image.
            NotReadyError: It does not have the mode, or not a known lens.
        """
        self._ob = sdk()
        cameras = self._cameras()
        if self._serial not in cameras:
            others = ", ".join(cameras) or "none"
            raise NoAnswerError(
                f"no Orbbec with serial number {self._serial} is connected (there are: {others}): check cable and "
                "camera.device.serial",
                code="no_answer.camera_missing",
            )
        try:
            return self._start(cameras[self._serial]())
        except self._ob.OBError as error:
            self.close()
            raise NoAnswerError(
                f"the Orbbec {self._serial} cannot be opened ({error}): close other programs that use it, or plug it "
                "in again"
            ) from error
        except BaseException:
            self.close()
            raise

    def _start(self, device: Any) -> CameraProfile:
        ob, mode = self._ob, self._mode
        pipeline = ob.Pipeline(device)
        color = self._choose(pipeline, ob.OBSensorType.COLOR_SENSOR, ob.OBFormat.RGB)
        depth = self._choose(pipeline, ob.OBSensorType.DEPTH_SENSOR, ob.OBFormat.Y16)
        config = ob.Config()
        config.enable_stream(color)
        config.enable_stream(depth)
        config.set_frame_aggregate_output_mode(ob.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        pipeline.start(config)
        self._pipeline, self._device, self._heard = pipeline, device, time.monotonic()
        first = pipeline.wait_for_frames(int(START_TIME * 1e3))
        if first is None:
            message = f"the Orbbec {self._serial} gives no pair of images: take a port of USB 3, or another mode"
            raise NoAnswerError(message)
        extrinsics = depth.get_extrinsic_to(color)
        R = np.array(extrinsics.rot, np.float64).reshape(3, 3)
        info = device.get_device_info()
        return CameraProfile(
            model=info.get_name(),
            serial=info.get_serial_number(),
            color=self._lens(color),
            fps=float(mode.fps),
            depth=self._lens(depth),
            X_color_depth=transform(R, 1e-3 * np.array(extrinsics.transform, np.float64)),
            depth_scale=1e-3 * first.get_depth_frame().get_depth_scale(),
            auto_exposure=self._auto_exposure(device),
            firmware=info.get_firmware_version(),
        )

    def fetch(self, timeout: float) -> RawImages | None:
        """Wait for the next pair.

        Args:
            timeout: Longest wait [s].

        Returns:
            The pair; None if none came.

        Raises:
            NoAnswerError: The camera is gone.
        """
        frames = self._pipeline.wait_for_frames(max(1, int(timeout * 1e3)))
        color = None if frames is None else frames.get_color_frame()
        depth = None if frames is None else frames.get_depth_frame()
        if color is None or depth is None:
            self._check_connected()
            return None
        self._heard = time.monotonic()
        return RawImages(
            np.array(np.frombuffer(color.get_data(), np.uint8)).reshape(color.get_height(), color.get_width(), 3),
            np.array(np.frombuffer(depth.get_data(), np.uint16)).reshape(depth.get_height(), depth.get_width()),
            1e-6 * color.get_timestamp_us(),
            1e-6 * depth.get_timestamp_us(),
        )

    def close(self) -> None:
        """Stop both streams."""
        pipeline, self._pipeline, self._device = self._pipeline, None, None
        if pipeline is not None:
            with contextlib.suppress(self._ob.OBError):  # it is gone
                pipeline.stop()

    def _check_connected(self) -> None:
        if time.monotonic() - self._heard > SILENCE:
            if self._serial not in self._cameras():
                message = f"the Orbbec {self._serial} is unplugged: plug it in, and open it again"
                raise NoAnswerError(message, code="no_answer.camera_unplugged")
            self._heard = time.monotonic()

    def _choose(self, pipeline: Any, sensor: Any, layout: Any) -> Any:
        """The mode of a stream: for the depth the size next to the colour's."""
        ob, mode = self._ob, self._mode
        profiles = pipeline.get_stream_profile_list(sensor)
        modes = [profiles.get_stream_profile_by_index(i).as_video_stream_profile() for i in range(profiles.get_count())]
        modes = [m for m in modes if m.get_format() == layout and m.get_fps() == mode.fps]
        if sensor == ob.OBSensorType.COLOR_SENSOR:
            fitting = [m for m in modes if (m.get_width(), m.get_height()) == (mode.width, mode.height)]
        else:
            fitting = sorted(modes, key=lambda m: abs(m.get_width() * m.get_height() - mode.width * mode.height))
        if not fitting:
            has = ", ".join(sorted({f"{m.get_width()}x{m.get_height()}" for m in modes})) or "none"
            raise NotReadyError(
                f"the Orbbec has no {sensor.name} of {mode.width}x{mode.height} at {mode.fps} Hz (sizes at this rate: "
                f"{has}): choose another size or rate"
            )
        return fitting[0]

    def _auto_exposure(self, device: Any) -> bool | None:
        ob = self._ob
        automatic = ob.OBPropertyID.OB_PROP_COLOR_AUTO_EXPOSURE_BOOL
        if not device.is_property_supported(automatic, ob.OBPermissionType.PERMISSION_READ):
            return None
        return bool(device.get_bool_property(automatic))

    def _lens(self, profile: Any) -> Lens:
        k, d = profile.get_intrinsic(), profile.get_distortion()
        pinhole = CameraIntrinsics(k.fx, k.fy, k.cx, k.cy, k.width, k.height)
        coefficients = (d.k1, d.k2, d.p1, d.p2, d.k3, d.k4, d.k5, d.k6)
        if not any(coefficients):
            return Lens(pinhole)
        models, model = self._ob.OBCameraDistortionModel, d.model
        if model in (models.BROWN_CONRADY, models.BROWN_CONRADY_K6):
            return Lens(pinhole, LensModel.BROWN_CONRADY, coefficients)
        if model == models.MODIFIED_BROWN_CONRADY:
            return Lens(pinhole, LensModel.MODIFIED_BROWN_CONRADY, coefficients)
        message = f"this Orbbec's lens is {model}, which the driver does not know: use another mode"
        raise NotReadyError(message, code="not_ready.camera_lens")
