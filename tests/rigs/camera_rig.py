"""A camera's own driver in the place of the simulated camera.

What the job does with the frames comes from the simulation's ground truth; whether there are any, and whether they may
be used, is what the driver says.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

from tests.rigs import software_airo
from tests.rigs.camera_devices import (
    COLOR,
    AiroDevice,
    CameraEvent,
    EmulatedCamera,
    OrbbecDevice,
    RealSenseDevice,
    RecordedDevice,
)
from toolee_robot.devices.cameras import StreamedCamera, orbbec, realsense
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimStation
from toolee_robot.station import CameraConfig, CameraDevice, sim_station
from toolee_robot.stations.camera import ORBBEC, REALSENSE, RECORDED, open_camera
from toolee_robot.types import CameraIntrinsics, RgbdFrame

SERIAL, OTHER_SERIAL = "832112070123", "832112070999"
"""Serial number of the station file's camera, and of another one."""


def _camera(driver: str, k: CameraIntrinsics = COLOR) -> CameraConfig:
    device = CameraDevice(driver, SERIAL, 0.2)
    return replace(
        sim_station().camera, fx=k.fx, fy=k.fy, cx=k.cx, cy=k.cy, width=k.width, height=k.height, device=device
    )


@dataclass(frozen=True)
class CameraKind:
    """A kind of camera.

    Attributes:
        label: Name of the rows' column: the driver, and what is at its other end.
        config: What a station file says of it.
        make: Makes the camera, given the connected one's serial number, what happens to it, and a folder.
        sdk: Imports what the driver needs.
        lacks: Events that cannot happen to it, or not be noticed, and why.
        codes: Codes of errors that are other than those of most cameras, by event.
        other: Code of the error of another camera than the file's; empty where it cannot be told.
        at_once: Events that can happen at any moment.
    """

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
        "airo-camera-toolkit (no software device)", _camera("airo", software_airo.COLOR), AiroDevice, lambda: None,
        lacks={
            CameraEvent.REPEATED: "its images carry no stamps",
            CameraEvent.LATE: "its images carry no stamps: a late one is not noticed",
        },
        codes={CameraEvent.SILENT: "no_answer.camera_unplugged"},  # the toolkit itself gives up waiting
        other="", at_once=(_FROZEN, _UNPLUGGED),
    ),
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
    """A camera behind its own driver, as a `hal.RgbdCamera` of the simulated station; use it in its `with` block.

    The driver runs in the host's time, which passes in the simulation while it is asked; stamps are converted.

    Attributes:
        device: The camera.
    """

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
