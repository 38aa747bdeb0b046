"""What `hal.RgbdCamera` promises, asked of every camera: the simulated one, a recording, the RealSense driver on
librealsense's software device, Orbbec's on OrbbecSDK's playback device; with --camera lab.yaml, the station file's."""

from __future__ import annotations

import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.contract.lab import station_of
from tests.errors import raises
from tests.rigs.camera_rig import CameraEvent, OrbbecDevice
from toolee_robot.devices.cameras import StreamedCamera
from toolee_robot.devices.cameras.realsense import RealSenseStream
from toolee_robot.devices.cameras.recording import RecordedStream, RecordingWriter
from toolee_robot.devices.cameras.stream import CameraMode
from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.hal import Clock, RgbdCamera
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.software_realsense import COLOR, SERIAL, SoftwareRealSense
from toolee_robot.station import CameraConfig, sim_station
from toolee_robot.stations.camera import open_camera
from toolee_robot.types import CameraIntrinsics, RgbdFrame

EARLY = 1e-6
"""Tolerance of the comparison of stamps [s]."""


class Rig(ABC):
    """A camera, and what can go wrong with it."""

    camera: RgbdCamera
    clock: Clock

    @abstractmethod
    def freeze(self) -> None:
        """No new frame comes any more."""

    def thaw(self) -> None:
        """New frames come again."""
        raise NotImplementedError


class SimRig(Rig):
    """The simulated camera."""

    def __init__(self, simulation: SimStation) -> None:
        assert isinstance(simulation.station.camera, SimCamera)
        self.camera = self._camera = simulation.station.camera
        self.clock = simulation.station.clock

    def freeze(self) -> None:
        self._camera.freeze()

    def thaw(self) -> None:
        self._camera.thaw()


class RecordedRig(Rig):
    """A recording of a second and a half; what comes after its end is nothing."""

    def __init__(self, folder: Path) -> None:
        k = CameraIntrinsics(90.0, 91.0, 47.0, 35.0, 96, 72)
        rng = np.random.default_rng(0)
        with RecordingWriter(folder, "toy", "77", 30.0, k) as writer:
            for n in range(45):
                rgb = rng.integers(0, 255, (72, 96, 3)).astype(np.uint8)
                depth = (0.5 + 0.3 * rng.random((72, 96))).astype(np.float32)
                writer.add(RgbdFrame(rgb, depth, k, 1000.0 + n / 30))
        self.clock = HostClock()
        self.camera = StreamedCamera(RecordedStream(folder, self.clock), self.clock)

    def freeze(self) -> None:
        self.clock.sleep(1.7)


class RealSenseRig(Rig):
    """The RealSense driver on a software device."""

    def __init__(self, device: SoftwareRealSense) -> None:
        self._device = device
        self.clock = HostClock()
        mode = CameraMode(COLOR.width, COLOR.height, 30, exposure=0.008)
        self.camera = StreamedCamera(RealSenseStream(SERIAL, mode, device.devices), self.clock)

    def freeze(self) -> None:
        self._device.frozen = True
        self.clock.sleep(0.2)

    def thaw(self) -> None:
        self._device.frozen = False


class OrbbecRig(Rig):
    """The Orbbec driver on a recording that the maker's SDK plays; after a pause it is late for good."""

    def __init__(self, device: OrbbecDevice) -> None:
        self._device = device
        self.clock = HostClock()
        self.camera = StreamedCamera(device.stream(SERIAL), self.clock)

    def freeze(self) -> None:
        self._device.happen()
        self.clock.sleep(0.2)


class LabRig(Rig):
    """The camera of a station file. Nothing is done to it."""

    def __init__(self, config: CameraConfig) -> None:
        self.clock = HostClock()
        self.camera = open_camera(config, self.clock)

    def freeze(self) -> None:
        raise NotImplementedError


TIERS = {
    "simulated": pytest.mark.sim,
    "recorded": pytest.mark.realtime(light=True),
    "realsense": pytest.mark.realtime(light=True),
    "orbbec": pytest.mark.realtime(light=True),
    "lab": pytest.mark.realtime,
}


def on(*rigs: str) -> pytest.MarkDecorator:
    """Which cameras a promise is asked of."""
    return pytest.mark.parametrize("rig", [pytest.param(rig, marks=TIERS[rig]) for rig in rigs], indirect=True)


@pytest.fixture
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
    if request.param == "recorded":
        yield RecordedRig(tmp_path / "frames")
    elif request.param == "lab":
        yield LabRig(station_of(request.config, "--camera").camera)
    elif request.param == "realsense":
        sdk = pytest.importorskip("pyrealsense2", exc_type=ImportError)
        with SoftwareRealSense(sdk) as device:
            yield RealSenseRig(device)
    elif request.param == "orbbec":
        if importlib.util.find_spec("pyorbbecsdk") is None:
            pytest.skip("needs pyorbbecsdk2: docs/start/install.md")
        with OrbbecDevice(SERIAL, CameraEvent.SILENT, tmp_path) as orbbec:
            yield OrbbecRig(orbbec)
    else:
        with SimStation.build(sim_station(), 100) as simulation:
            yield SimRig(simulation)


@on("simulated", "recorded", "realsense", "orbbec", "lab")
def test_its_frames_are_new_registered_and_of_its_intrinsics(rig: Rig) -> None:
    with rig.camera as camera:
        assert isinstance(camera, RgbdCamera)
        k, stamps = camera.intrinsics, []
        for _ in range(3):
            asked = rig.clock.now()
            frame = camera.read()
            assert asked - EARLY <= frame.stamp <= rig.clock.now() + EARLY
            assert frame.intrinsics == k
            assert frame.rgb.shape == (k.height, k.width, 3)
            assert frame.depth.shape == (k.height, k.width)
            assert frame.depth.dtype == np.float32
            known = frame.depth[np.isfinite(frame.depth) & (frame.depth != 0)]
            assert known.size > 0.3 * frame.depth.size
            assert 0.1 < np.median(known) < 10.0
            assert known.min() > 0.0
            stamps.append(frame.stamp)
        assert stamps == sorted(set(stamps))


@on("simulated", "recorded", "realsense", "orbbec", "lab")
def test_closed_it_gives_nothing(rig: Rig) -> None:
    with rig.camera as camera:
        camera.read()
    with raises(DeviceError, "device.closed"):
        rig.camera.read()
    with rig.camera as camera:
        camera.read()


@on("simulated", "recorded", "realsense", "orbbec")
def test_without_a_new_frame_it_says_so_within_the_time(rig: Rig) -> None:
    with rig.camera as camera:
        camera.read()
        rig.freeze()
        asked = rig.clock.now()
        with pytest.raises(StaleDataError) as raised:
            camera.read(max_age=0.3)
        assert raised.value.code.startswith("stale_data.camera")
        assert rig.clock.now() - asked < 1.0


@on("simulated", "realsense")
def test_it_goes_on_when_frames_come_again(rig: Rig) -> None:
    with rig.camera as camera:
        camera.read()
        rig.freeze()
        with pytest.raises(StaleDataError):
            camera.read(max_age=0.3)
        rig.thaw()
        asked = rig.clock.now()
        assert camera.read().stamp >= asked - EARLY


@on("simulated", "recorded", "realsense", "orbbec", "lab")
def test_a_frame_that_was_given_stays_as_it_was(rig: Rig) -> None:
    with rig.camera as camera:
        first = camera.read()
        rgb, depth = first.rgb.copy(), first.depth.copy()
        camera.read()
        np.testing.assert_array_equal(first.rgb, rgb)
        np.testing.assert_array_equal(first.depth, depth)
