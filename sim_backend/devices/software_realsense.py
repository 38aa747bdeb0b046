"""A software device of librealsense, fed with pictures: what the RealSense driver is run against."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.runtime.clock import HostClock
from toolee_robot.types import CameraIntrinsics

Pictures = tuple[NDArray[np.uint8], NDArray[np.uint16]]
"""Colour, (H, W, 3), and depth, (h, w) [mm]."""

SERIAL = "832112070123"
COLOR = CameraIntrinsics(390.0, 391.0, 213.2, 119.1, 424, 240)
DEPTH = CameraIntrinsics(215.0, 215.0, 211.5, 121.0, 424, 240)
COEFFICIENTS = (0.06, -0.12, 0.0007, -0.0004, 0.03)
BASELINE = 0.015
FPS = 30


class SoftwareRealSense:
    """A D435 as software: a stereo module and a colour sensor whose images this process pushes.

    From the SDK: profiles, lenses, extrinsics, options, queues, recorder and playback are librealsense's own.
    Published: units of depth and exposure. Assumed: a clock that is 40 ppm fast, colour 2 ms after depth, no delay but
    `delay`, noise of 2 mm and 3 grey levels where no `pictures` are given, and that an unplugged camera is silent and
    no longer found.

    Args:
        rs: The SDK.
        color_model: Distortion of the colour lens, one of the SDK's; None for a D435's.
        color: Pinhole model of the colour camera.
        depth: That of the depth camera, which looks the same way BASELINE to the right.
        coefficients: Distortion of the colour lens, at most five; not of `color_model` none.
        serial: Serial number.
        fps: Frames per second, on `clock`.
        clock: Clock of the host.
        pictures: What the two cameras see now, with their noise, or None for no frame this time; None for `rgb` and
            `depth`.

    Attributes:
        clock_offset: Added to the stamps [s].
        clock_rate: Rate of its clock against the host's.
        frozen: Whether the picture no longer changes.
        repeats: Whether the stamps no longer change.
        silent: Whether no image comes.
        plugged: Whether it is found.
        delay: Extra time between exposure and arrival [s].
        depth: What the depth camera sees, (H, W) [mm], without noise.
        rgb: What the colour camera sees, (H, W, 3), without noise.
    """

    def __init__(
        self,
        rs: Any,
        color_model: Any = None,
        color: CameraIntrinsics = COLOR,
        depth: CameraIntrinsics = DEPTH,
        *,
        coefficients: Sequence[float] = COEFFICIENTS,
        serial: str = SERIAL,
        fps: int = FPS,
        clock: Clock | None = None,
        pictures: Callable[[], Pictures | None] | None = None,
    ) -> None:
        self.rs = rs
        self._color, self._depth, self._serial, self._fps = color, depth, serial, fps
        self._clock: Clock = HostClock() if clock is None else clock
        self._see = pictures
        self._distortion = tuple(coefficients)
        self.clock_offset, self.clock_rate, self.delay = 5000.0, 1.0 + 40e-6, 0.0
        self.frozen = self.repeats = self.silent = False
        self.plugged = True
        self.depth: NDArray[np.float64] = np.full((depth.height, depth.width), 800.0)
        self.rgb: NDArray[np.uint8] = np.full((color.height, color.width, 3), 120, np.uint8)
        self.device = self._device(rs.distortion.inverse_brown_conrady if color_model is None else color_model)
        self._stop = threading.Event()
        self._number = 0

    def _device(self, color_model: Any) -> Any:
        rs = self.rs
        device = rs.software_device()
        device.register_info(rs.camera_info.serial_number, self._serial)
        device.register_info(rs.camera_info.name, "Intel RealSense D435 (software device)")
        device.register_info(rs.camera_info.firmware_version, "5.16.0.1")
        self._stereo, self._rgb = device.add_sensor("Stereo Module"), device.add_sensor("RGB Camera")
        none = rs.distortion.brown_conrady
        depth = self._video(rs.stream.depth, 0, 2, rs.format.z16, self._depth, none, (0.0,) * 5)
        color = self._video(
            rs.stream.color, 1, 3, rs.format.rgb8, self._color, color_model, self._coefficients(color_model)
        )
        self._depth_profile = self._stereo.add_video_stream(depth, True)
        self._color_profile = self._rgb.add_video_stream(color, True)
        self._stereo.add_read_only_option(rs.option.depth_units, 0.001)
        for option, least, most, default in (
            (rs.option.exposure, 1.0, 10000.0, 156.0),
            (rs.option.enable_auto_exposure, 0.0, 1.0, 1.0),
        ):
            allowed = rs.option_range()
            allowed.min, allowed.max, allowed.step, allowed.default = least, most, 1.0, default
            self._rgb.add_option(option, allowed, True)
        there, back = rs.extrinsics(), rs.extrinsics()
        there.rotation = back.rotation = np.eye(3).ravel().tolist()
        there.translation, back.translation = [BASELINE, 0.0, 0.0], [-BASELINE, 0.0, 0.0]
        self._depth_profile.register_extrinsics_to(self._color_profile, there)
        self._color_profile.register_extrinsics_to(self._depth_profile, back)
        return device

    def _coefficients(self, color_model: Any) -> tuple[float, ...]:
        given = () if color_model == self.rs.distortion.none else self._distortion
        return (*given, *(0.0,) * (5 - len(given)))

    def _video(
        self, kind: Any, uid: int, bpp: int, layout: Any, k: CameraIntrinsics, model: Any, c: tuple[float, ...]
    ) -> Any:
        stream, intrinsics = self.rs.video_stream(), self.rs.intrinsics()
        intrinsics.width, intrinsics.height = k.width, k.height
        intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = k.fx, k.fy, k.cx, k.cy
        intrinsics.model, intrinsics.coeffs = model, list(c)
        stream.type, stream.index, stream.uid, stream.fmt = kind, 0, uid, layout
        stream.width, stream.height, stream.fps, stream.bpp = k.width, k.height, self._fps, bpp
        stream.intrinsics = intrinsics
        return stream

    def devices(self) -> list[Any]:
        """The devices that a driver finds."""
        return [self.device] if self.plugged else []

    @property
    def X_color_depth(self) -> Array:
        """Pose of the depth camera in the colour camera, (4, 4) [m]."""
        X = np.eye(4)
        X[0, 3] = BASELINE
        return X

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._feed, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _feed(self) -> None:
        rng, clock = np.random.default_rng(0), self._clock
        due = clock.now()
        stamp, pictures = 0.0, self._noisy(rng)
        while not self._stop.is_set():
            due = max(due + 1 / self._fps, clock.now())
            clock.sleep(due - clock.now())
            exposed = clock.now()
            if self.delay:
                clock.sleep(self.delay)
            if self.silent or not self.plugged:
                continue
            if not self.frozen:
                seen = self._noisy(rng) if self._see is None else self._see()
                if seen is None:
                    continue
                pictures = seen
            if not self.repeats:
                stamp = (exposed * self.clock_rate + self.clock_offset) * 1e3
            self._number += 1
            rs = self.rs
            for sensor, profile, pixels, bpp, late in (
                (self._stereo, self._depth_profile, pictures[1], 2, 0.0),
                (self._rgb, self._color_profile, pictures[0], 3, 2.0),
            ):
                frame = rs.software_video_frame()
                frame.pixels, frame.bpp, frame.stride = pixels, bpp, pixels.shape[1] * bpp
                frame.timestamp, frame.domain = stamp + late, rs.timestamp_domain.hardware_clock
                frame.frame_number, frame.profile = self._number, profile.as_video_stream_profile()
                frame.depth_units = 0.001
                sensor.on_video_frame(frame)

    def _noisy(self, rng: np.random.Generator) -> Pictures:
        rgb = np.clip(self.rgb + rng.integers(-3, 4, self.rgb.shape), 0, 255).astype(np.uint8)
        noisy = self.depth + rng.integers(-2, 3, self.depth.shape)
        return rgb, np.where(self.depth > 0, noisy, 0).astype(np.uint16)
