"""What the doctor says of hand and camera, on the simulated station with things broken in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Self

import numpy as np
import pytest

from toolee_robot.doctor.devices import check_camera, check_hand
from toolee_robot.findings import Finding, Level
from toolee_robot.hal import Clock, HandState, RgbdCamera
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.hand import SimHand
from toolee_robot.station import sim_station
from toolee_robot.types import CameraIntrinsics, RgbdFrame

pytestmark = pytest.mark.sim

_CONFIG = sim_station()


@pytest.fixture(scope="module")
def simulation() -> Iterator[SimStation]:
    with SimStation.build(_CONFIG) as simulation:
        yield simulation


def test_devices_as_they_should_be(simulation: SimStation) -> None:
    station = simulation.station
    findings = [
        check_hand(station.hand, _CONFIG),
        *check_camera(station.camera, station.clock, _CONFIG),
    ]
    assert {f.level for f in findings} == {Level.OK}, findings
    assert [f.name for f in findings] == ["hand", "camera", "depth"]


@pytest.fixture
def hand(simulation: SimStation) -> Iterator[SimHand]:
    hand = simulation.station.hand
    assert isinstance(hand, SimHand)
    yield hand
    hand.recover()


def test_a_hand_that_is_not_well(simulation: SimStation, hand: SimHand) -> None:
    def found() -> tuple[Level, str]:
        finding = check_hand(hand, _CONFIG)
        return finding.level, finding.message

    hand.temperature = 40.0
    assert found() == (Level.OK, "answers, empty, 24 joints, 40 °C")
    hand.temperature = 71.0
    assert found() == (Level.FAIL, "71 °C, above the allowed 65 °C")
    hand.fault = "index finger stalled"
    assert found() == (Level.FAIL, "index finger stalled")
    hand.cut_link()
    simulation.station.clock.sleep(0.5)
    level, expected_text = found()
    assert level is Level.FAIL
    assert "old" in expected_text


class _FullHand(SimHand):
    """Holds something."""

    def state(self, max_age: float = 0.1) -> HandState:
        return replace(super().state(max_age), holding=True)


def test_a_hand_that_holds_something(simulation: SimStation) -> None:
    finding = check_hand(_FullHand(simulation.world, 0.9), _CONFIG)
    assert (finding.level, finding.message) == (Level.WARN, "it holds something")


def test_a_camera_that_is_frozen(simulation: SimStation) -> None:
    station = simulation.station
    assert isinstance(station.camera, SimCamera)
    station.camera.freeze()
    try:
        (finding,) = check_camera(station.camera, station.clock, _CONFIG)
    finally:
        station.camera.thaw()
    assert finding.level is Level.FAIL
    assert "no new frame" in finding.message


class _ReplayedCamera:
    """Gives one frame of the simulated camera again and again as if exposed now, changed. slow: [s] that it takes."""

    def __init__(self, clock: Clock, frame: RgbdFrame, slow: float = 0.0, **changes: Callable[[Any], Any]) -> None:
        self._clock, self._frame, self._slow, self._changes = clock, frame, slow, changes

    @property
    def intrinsics(self) -> CameraIntrinsics:
        return self._frame.intrinsics

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def read(self, max_age: float = 0.5) -> RgbdFrame:  # noqa: ARG002
        frame = replace(self._frame, stamp=self._clock.now())
        self._clock.sleep(1 / 30 + self._slow)
        return replace(frame, **{k: change(getattr(frame, k)) for k, change in self._changes.items()})


@pytest.fixture(scope="module")
def frame(simulation: SimStation) -> RgbdFrame:
    return simulation.station.camera.read()


def _camera(simulation: SimStation, camera: RgbdCamera) -> dict[str, Finding]:
    return {f.name: f for f in check_camera(camera, simulation.station.clock, _CONFIG)}


def test_a_camera_that_is_slow(simulation: SimStation, frame: RgbdFrame) -> None:
    found = _camera(simulation, _ReplayedCamera(simulation.station.clock, frame, slow=0.8))
    assert (found["camera"].level, found["camera"].message) == (Level.WARN, "a frame takes 0.83 s")


@pytest.mark.parametrize(
    ("changes", "name", "expected_text"),
    [
        ({"stamp": lambda _: 1.0}, "camera", "repeats"),
        ({"stamp": lambda t: t - 2.0}, "camera", "is 2.03 s old"),
        ({"stamp": lambda t: t + 2.0}, "camera", "is -1.97 s old"),
        ({"depth": np.zeros_like}, "depth", "0% of the image"),
        ({"intrinsics": lambda k: replace(k, fx=k.fx + 3.0)}, "intrinsics", "not the station file's"),
    ],
)
def test_a_camera_that_is_not_well(
    simulation: SimStation, frame: RgbdFrame, changes: dict[str, Any], name: str, expected_text: str
) -> None:
    finding = _camera(simulation, _ReplayedCamera(simulation.station.clock, frame, **changes))[name]
    assert finding.level is Level.FAIL
    assert expected_text in finding.message
