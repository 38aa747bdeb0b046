"""What the doctor says of arm, hand, camera and person, on the simulated station with things broken in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Self

import numpy as np
import pytest

from toolee_robot.doctor.devices import check_arm, check_camera, check_hand, check_person
from toolee_robot.findings import Finding, Level
from toolee_robot.hal import Clock, HandState, RgbdCamera
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.hand import SimHand
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.types import CameraIntrinsics, RgbdFrame

pytestmark = pytest.mark.sim

_CONFIG = sim_station()


@pytest.fixture(scope="module")
def simulation() -> Iterator[SimStation]:
    with SimStation.build(_CONFIG) as simulation:
        yield simulation


@pytest.fixture
def arm(simulation: SimStation) -> Iterator[SimArm]:
    arm = simulation.station.arm
    assert isinstance(arm, SimArm)
    yield arm
    arm.restore_link()
    arm.make_ready()
    arm.reset()


def _arm(simulation: SimStation, config: StationConfig = _CONFIG) -> Finding:
    return check_arm(simulation.station.arm, simulation.station.hand, config)


def test_devices_as_they_should_be(simulation: SimStation) -> None:
    station = simulation.station
    findings = [
        _arm(simulation),
        check_hand(station.hand, _CONFIG),
        *check_camera(station.camera, station.clock, _CONFIG),
        check_person(station.person),
    ]
    assert {f.level for f in findings} == {Level.OK}, findings
    assert [f.name for f in findings] == ["arm", "hand", "camera", "depth", "person"]


def test_nothing_moves(simulation: SimStation) -> None:
    station = simulation.station
    before = station.arm.state().joints.q, station.hand.state().joints.q
    _arm(simulation)
    check_hand(station.hand, _CONFIG)
    np.testing.assert_allclose(station.arm.state().joints.q, before[0], atol=1e-4)
    np.testing.assert_allclose(station.hand.state().joints.q, before[1], atol=1e-2)


def test_a_stopped_arm(simulation: SimStation, arm: SimArm) -> None:
    arm.protective_stop()
    assert (_arm(simulation).level, _arm(simulation).message) == (Level.FAIL, "protective stop")
    arm.make_ready()
    arm.emergency_stop()
    assert (_arm(simulation).level, _arm(simulation).message) == (Level.FAIL, "emergency stop")


def test_an_arm_that_tells_nothing_new(simulation: SimStation, arm: SimArm) -> None:
    arm.cut_link()
    simulation.station.clock.sleep(0.5)
    finding = _arm(simulation)
    assert finding.level is Level.FAIL
    assert "old" in finding.message


@pytest.mark.parametrize(
    ("section", "changes", "expected_text"),
    [
        ("scene", {"workspace_lower": (-1.0, -1.2, 1.2), "workspace_upper": (1.2, 1.2, 1.6)}, "outside the workspace"),
        ("strike", {"clearance": 0.2}, "stands too near"),
    ],
)
def test_an_arm_that_cannot_be_planned_for(
    simulation: SimStation, section: str, changes: dict[str, Any], expected_text: str
) -> None:
    finding = _arm(simulation, replace(_CONFIG, **{section: replace(getattr(_CONFIG, section), **changes)}))
    assert finding.level is Level.FAIL
    assert expected_text in finding.message


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
