"""Cameras before their own drivers, each of which can do one thing wrong.

A RealSense is librealsense's software device, to which a fault can happen at any moment. Orbbec's SDK has a playback
device, and recorded frames are played as well: what is to go wrong with the pictures is in the recording from HEALTHY
seconds on.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.rigs import orbbec_recording
from tests.rigs.orbbec_recording import write_recording
from toolee_robot.devices.cameras import CameraStream, StreamedCamera, orbbec, realsense
from toolee_robot.devices.cameras.orbbec import OrbbecStream
from toolee_robot.devices.cameras.realsense import RealSenseStream
from toolee_robot.devices.cameras.recording import RecordedStream, RecordingWriter
from toolee_robot.devices.cameras.stream import CameraMode
from toolee_robot.errors import UserError
from toolee_robot.hal import Clock
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.software_realsense import SoftwareRealSense
from toolee_robot.station import CameraConfig, CameraDevice, sim_station
from toolee_robot.stations import camera
from toolee_robot.stations.camera import ORBBEC, REALSENSE, RECORDED, open_camera
from toolee_robot.types import CameraIntrinsics, RgbdFrame

COLOR, DEPTH = CameraIntrinsics(88.3, 88.4, 48.2, 26.8, 96, 54), CameraIntrinsics(48.7, 48.7, 47.7, 27.3, 96, 54)
"""Pinhole models of the cameras whose pictures are made here: small ones, which cost little."""
FPS = 60
"""Frames per second of the software device."""
PLAYED_FPS = 10
"""Frames per second of recorded frames."""
HEALTHY = 1.0
"""Time from its beginning for which a recording shows no fault [s]; a driver's pairs count after 15 of them."""
PLAYED = 30.0
"""Length of a recording [s]; a job's two looks at the tool are over in four."""
LATE = 0.4
"""How late late frames are [s]."""
DISTANCE, TOO_NEAR = 800.0, 8.0
"""What the cameras see [mm], and what they would if a step of the depth were a thousandth of what they say."""


class CameraEvent(StrEnum):
    """What happens to a camera. The values are the rows' names."""

    NOTHING = "nothing"
    SILENT = "no frame comes any more"
    FROZEN = "picture frozen, with new timestamps"
    REPEATED = "timestamp repeated"
    LATE = "frames come late"
    UNPLUGGED = "camera unplugged"
    BLIND = "camera has no depth"
    UNIT = "depth in another unit"


IN_PICTURES = (CameraEvent.FROZEN, CameraEvent.REPEATED, CameraEvent.BLIND, CameraEvent.UNIT)
"""What is in a recording from HEALTHY on."""


class EmulatedCamera(Protocol):
    """A camera before its driver; use it in its `with` block."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def stream(self, serial: str) -> CameraStream:
        """The camera's own driver."""

    def happen(self) -> None:
        """Let the event happen; waits for it where it is in a recording."""


class RealSenseDevice:
    """A RealSense: librealsense's software device."""

    def __init__(self, serial: str, event: CameraEvent, _: Path) -> None:
        rs = realsense.sdk()
        self._emulated = SoftwareRealSense(rs, rs.distortion.none, COLOR, DEPTH, serial=serial, fps=FPS)
        self._event = event

    def __enter__(self) -> Self:
        self._emulated.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._emulated.__exit__()

    def stream(self, serial: str) -> CameraStream:
        return RealSenseStream(serial, CameraMode(COLOR.width, COLOR.height, FPS), self._emulated.devices)

    def happen(self) -> None:
        emulated, event = self._emulated, self._event
        emulated.silent = event is CameraEvent.SILENT
        emulated.frozen = event is CameraEvent.FROZEN
        emulated.repeats = event is CameraEvent.REPEATED
        emulated.plugged = event is not CameraEvent.UNPLUGGED
        emulated.delay = LATE if event is CameraEvent.LATE else 0.0
        millimetres = {CameraEvent.BLIND: 0.0, CameraEvent.UNIT: TOO_NEAR}.get(event, DISTANCE)
        emulated.depth = np.full_like(emulated.depth, millimetres)


def plug_in(patch: pytest.MonkeyPatch, devices: Callable[[], list[Any]]) -> None:
    """Let the RealSense's driver find these devices alone."""

    def driver(config: CameraConfig, device: CameraDevice, _: Clock) -> RealSenseStream:
        mode = CameraMode(config.width, config.height, device.fps, device.exposure)
        return RealSenseStream(device.serial, mode, devices)

    patch.setitem(camera._DRIVERS, "realsense", driver)


class OrbbecDevice:
    """An Orbbec: OrbbecSDK's playback device."""

    def __init__(self, serial: str, event: CameraEvent, folder: Path) -> None:
        self._serial, self._event, self._path = serial, event, folder / "frames.bag"
        self._plugged: dict[str, Callable[[], Any]] = {serial: self._device}
        self._playback: Any = None

    def __enter__(self) -> Self:
        fps, event = orbbec_recording.FPS, self._event
        last = int(HEALTHY * fps) - 1
        stamp = last if event is CameraEvent.REPEATED else None
        pictures = _played(fps, event)
        write_recording(self._path, pictures, self._serial, color=COLOR, depth=DEPTH, last_stamp=stamp)
        return self

    def __exit__(self, *_: object) -> None:
        self._playback = None

    def stream(self, serial: str) -> CameraStream:
        mode = CameraMode(COLOR.width, COLOR.height, orbbec_recording.FPS)
        return OrbbecStream(serial, mode, lambda: self._plugged)

    def happen(self) -> None:
        if self._event in IN_PICTURES:
            _wait_until(self._begin + HEALTHY)
        elif self._event is not CameraEvent.NOTHING:
            if self._event is CameraEvent.UNPLUGGED:
                self._plugged.clear()
            self._playback.pause()
            if self._event is CameraEvent.LATE:
                time.sleep(LATE)
                self._playback.resume()

    def _device(self) -> Any:
        self._playback, self._begin = orbbec.sdk().PlaybackDevice(str(self._path)), time.monotonic()
        return self._playback


class RecordedDevice:
    """Recorded frames."""

    def __init__(self, serial: str, event: CameraEvent, folder: Path) -> None:
        self._serial, self._event, self._folder = serial, event, folder / "frames"

    def __enter__(self) -> Self:
        fps, event = float(PLAYED_FPS), self._event
        last = int(HEALTHY * fps) - 1
        pictures = _played(PLAYED_FPS, event)
        if event is CameraEvent.SILENT:
            del pictures[last + 1 :]
        with RecordingWriter(self._folder, "toy", self._serial, fps, COLOR) as writer:
            for number, (rgb, depth) in enumerate(pictures):
                stamped = min(number, last) if event is CameraEvent.REPEATED else number
                writer.add(RgbdFrame(rgb, 1e-3 * depth.astype(np.float32), COLOR, stamped / fps))
        return self

    def __exit__(self, *_: object) -> None: ...

    def stream(self, serial: str) -> CameraStream:  # noqa: ARG002  # a folder is opened, whoever's it is
        self._begin = time.monotonic()
        return RecordedStream(self._folder, HostClock())

    def happen(self) -> None:
        if self._event is not CameraEvent.NOTHING:
            _wait_until(self._begin + HEALTHY)


def _played(fps: int, event: CameraEvent) -> list[tuple[NDArray[np.uint8], NDArray[np.uint16]]]:
    """The pictures of a recording: noise, and from HEALTHY on what is wrong with them."""
    rng = np.random.default_rng(0)

    def picture(millimetres: float) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        rgb = rng.integers(100, 140, (COLOR.height, COLOR.width, 3)).astype(np.uint8)
        depth = millimetres + rng.integers(-2, 3, (DEPTH.height, DEPTH.width))
        return rgb, np.where(millimetres > 0.0, depth, 0).astype(np.uint16)

    healthy, rest = int(HEALTHY * fps), int((PLAYED - HEALTHY) * fps)
    pictures = [picture(DISTANCE) for _ in range(healthy)]
    if event is CameraEvent.FROZEN:
        return pictures + [pictures[-1]] * rest
    wrong = {CameraEvent.BLIND: 0.0, CameraEvent.UNIT: TOO_NEAR}.get(event, DISTANCE)
    two = [picture(wrong), picture(wrong)]  # in turn: no picture is that before it
    return pictures + [two[number % 2] for number in range(rest)]


def _wait_until(moment: float) -> None:
    time.sleep(max(0.0, moment - time.monotonic()))


SERIAL, OTHER_SERIAL = "832112070123", "832112070999"
"""Serial number of the station file's camera, and of another one."""


def _camera(driver: str, k: CameraIntrinsics = COLOR) -> CameraConfig:
    device = CameraDevice(driver, SERIAL, 0.2)
    return replace(
        sim_station().camera, fx=k.fx, fy=k.fy, cx=k.cx, cy=k.cy, width=k.width, height=k.height, device=device
    )


@dataclass(frozen=True)
class CameraKind:
    """A kind of camera."""

    label: str
    config: CameraConfig
    make: Callable[[str, CameraEvent, Path], EmulatedCamera]
    sdk: Callable[[], object]
    lacks: Mapping[CameraEvent, str] = field(default_factory=dict)
    codes: Mapping[CameraEvent, str] = field(default_factory=dict)
    other: str = "no_answer.camera_missing"
    at_once: tuple[CameraEvent, ...] = ()

    @property
    def missing(self) -> str:
        """Why it cannot be opened on this machine; empty where it can."""
        try:
            self.sdk()
        except UserError as error:
            return str(error)
        return ""


_FROZEN, _UNPLUGGED = CameraEvent.FROZEN, CameraEvent.UNPLUGGED
_PLAYED = {CameraEvent.REPEATED: "stale_data.camera"}
"""What is of one time is played at once: when a frame is asked for nothing is left."""
CAMERAS = (
    CameraKind("RealSense, software device", _camera(REALSENSE), RealSenseDevice, realsense.sdk,
               at_once=(_FROZEN, _UNPLUGGED)),
    CameraKind("Orbbec, playback device", _camera(ORBBEC), OrbbecDevice, orbbec.sdk, codes=_PLAYED,
               at_once=(_UNPLUGGED,)),
    CameraKind(
        "recorded frames", _camera(RECORDED), RecordedDevice, lambda: None,
        lacks={
            CameraEvent.LATE: "they come when they are due",
            CameraEvent.UNPLUGGED: "a folder has no cable",
        },
        codes=_PLAYED, other="not_ready.camera_serial",
    ),
)  # fmt: skip
"""The cameras that have a driver here."""


class DriverCamera:
    """A camera behind its own driver, as a `hal.RgbdCamera` of the simulated station; use it in its `with` block."""

    def __init__(
        self,
        simulation: SimStation | None,
        kind: CameraKind,
        event: CameraEvent = CameraEvent.NOTHING,
        connected: str = SERIAL,
        config: CameraConfig | None = None,
    ) -> None:
        self._simulation, self._clock = simulation, HostClock()
        self._kind, self._event, self._connected = kind, event, connected
        self._config = kind.config if config is None else config
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Connect."""
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            self.device = stack.enter_context(self._kind.make(self._connected, self._event, folder))
            stream = self.device.stream(SERIAL)
            self._camera: StreamedCamera = stack.enter_context(open_camera(self._config, self._clock, stream=stream))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def intrinsics(self) -> CameraIntrinsics:
        return self._camera.intrinsics

    @property
    def serial(self) -> str:
        """Serial number, as the driver tells it."""
        return self._camera.profile.serial

    def read(self, max_age: float = 0.5) -> RgbdFrame:
        assert self._simulation is not None, "a camera that is only opened"
        asked, began = self._simulation.station.clock.now(), self._clock.now()
        try:
            frame = self._camera.read(max_age)
        finally:
            self._simulation.world.advance(self._clock.now() - began)
        return replace(frame, stamp=asked + frame.stamp - began)
