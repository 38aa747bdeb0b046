"""A lab's station by its own drivers, every device emulated: the wires hold what the station file says."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover
from toolee_robot.control.supervisor_checks import UNSURE
from toolee_robot.devices.cameras import CameraProfile, RawImages
from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.devices.hands.ability import AbilityHand
from toolee_robot.devices.hands.inspire import InspireHand
from toolee_robot.devices.hands.shadow import ShadowHand
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.end_effectors import Category
from toolee_robot.errors import (
    ConfigError,
    DeviceError,
    LinkLostError,
    NotReadyError,
    OverrunError,
    PersonNearError,
    ProtectiveStopError,
    StaleDataError,
)
from toolee_robot.frames import angle_between, rotation_angle
from toolee_robot.hal import ArmStatus
from toolee_robot.robots.hands import HAND_FILES
from toolee_robot.sim_backend.cell_errors import NOMINAL
from toolee_robot.station import StationConfig, load_lab_station, load_station
from toolee_robot.stations.lab import LabStation, Purpose, check_purpose
from toolee_robot.stations.rehearsal import EmulatedLab, job_cell
from toolee_robot.stations.rehearsal.emulated_lab import claimed_address
from toolee_robot.types import HandWeight

EXAMPLES = Path(__file__).parents[2] / "examples"
LAB = EXAMPLES / "lab.yaml"
FACTOR = 0.5
"""Real-time factor."""


@pytest.fixture
def config() -> StationConfig:
    return load_lab_station(LAB)


@pytest.mark.parametrize("field", ["arm.host", "camera.device", "person", "calibration", "tool", "hand.port"])
def test_what_is_missing_is_named(config: StationConfig, field: str) -> None:
    section, _, name = field.partition(".")
    if field == "hand.port":
        lacking = _with_hand(config, "inspire", port=None)
    else:
        changed: Any = replace(getattr(config, section), **{name: None}) if name else None
        without: dict[str, Any] = {section: changed}
        lacking = replace(config, **without)
    with raises(ConfigError, says="the station file lacks what") as caught:
        LabStation(lacking, print)
    assert f"give {field};" in str(caught.value)
    if field in ("calibration", "tool", "hand.port"):
        check_purpose(lacking, Purpose.CALIBRATION)


@pytest.mark.parametrize("purpose", list(Purpose))
def test_a_recording_is_no_camera_of_a_station(config: StationConfig, purpose: Purpose) -> None:
    with raises(ConfigError, says="a recording cannot see"):
        LabStation(_driver(config, "recorded"), print, purpose=purpose)


def test_a_hand_that_cannot_be_emulated_is_not_rehearsed(
    config: StationConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = job_cell(_with_hand(config, "shadow", port="ws://127.0.0.1:9090"), LAB, 1)
    monkeypatch.delitem(HAND_FILES, cell.measured.hand.model)  # as a hand for which a lab brought the driver alone
    with raises(ConfigError, says="emulator"):
        EmulatedLab(cell, print, FACTOR, "ideal")


@pytest.mark.parametrize(
    "error",
    [
        StaleDataError("the arm's newest state is 0.31 s old", code="stale_data.arm"),
        LinkLostError("the robot's data were late", code="link_lost.data"),
        OverrunError("commands were sent late, by up to 31 ms,"),
        NotReadyError("the readings are late", code="not_ready.timing"),
        PersonNearError(f"nobody is known to hold the switch, {UNSURE}", code="person_near.during_motion"),
        PersonNearError("the hold-to-run switch was not taken", code="person_near.switch_not_taken"),
    ],
    ids=lambda error: str(error.code),
)
def test_what_comes_late_in_a_rehearsal_is_put_down_to_this_machine(config: StationConfig, error: DeviceError) -> None:
    lab, what, code = EmulatedLab(job_cell(config, LAB, 7401), print, 0.5, "harsh"), str(error), error.code
    with raises(type(error), code) as caught, lab.blaming_the_machine():
        raise error
    told = str(caught.value)
    assert caught.value is error, "with its report"
    assert told.startswith("data came late, because this machine is busy, or too slow")
    assert "Close other programs, or give a --real-time-factor under 0.5" in told
    assert told.endswith(what)


def test_what_is_no_matter_of_time_is_not_put_down_to_this_machine(config: StationConfig) -> None:
    lab = EmulatedLab(job_cell(config, LAB, 7401), print, 0.5, "harsh")
    with raises(ProtectiveStopError, "protective_stop") as caught, lab.blaming_the_machine():
        raise ProtectiveStopError("it hit something")
    assert str(caught.value) == "it hit something"
    assert not lab.why_late(PersonNearError("somebody is within the arm's reach", code="person_near.zone_occupied"))


def test_rehearsals_that_begin_together_have_an_address_each() -> None:
    with claimed_address() as first, claimed_address() as second:
        assert first != second
    with claimed_address() as again:
        assert again == first, "free again"


def test_the_rehearsed_cell_is_off_by_what_a_person_measures(config: StationConfig) -> None:
    cells = [job_cell(config, LAB, seed) for seed in range(7401, 7421)]
    again = job_cell(config, LAB, 7401)
    assert (again.true, again.measured) == (cells[0].true, cells[0].measured)
    X = config.camera.X_base_camera
    moved = [np.linalg.norm(cell.true.camera.X_base_camera[:3, 3] - X[:3, 3]) for cell in cells]
    assert config.calibration is not None
    assert 0.5 < np.sqrt(np.mean(np.square(moved)) / 3.0) / config.calibration.residual < 1.6
    assert 0.0 < max(rotation_angle(cell.true.camera.X_base_camera[:3, :3].T @ X[:3, :3]) for cell in cells) < 0.005
    beside = np.array([cell.true.work.nail_xy for cell in cells]) - config.work.nail_xy
    assert 0.5 < np.sqrt(np.mean(beside**2)) / NOMINAL.nail_beside < 1.6
    for cell in cells:
        assert cell.measured.camera == config.camera, "the job knows what the file says"
        assert cell.measured.work == config.work
        told, tool = cell.measured.tool, cell.tool
        assert told is not None
        assert told.X_tool_face is not None
        assert told.mass is not None
        X_face = tool.ee(Category.HAMMER_HEAD).X_tool_ee
        assert 0.0 < np.linalg.norm(told.X_tool_face[:3, 3] - X_face[:3, 3]) < 6.0 * NOMINAL.ruler
        assert angle_between(told.X_tool_face[:3, 2], X_face[:3, 2]) < np.deg2rad(6.0)
        assert abs(told.mass / tool.mass - 1.0) < 0.06


@pytest.mark.nightly
@pytest.mark.realtime
def test_every_device_is_its_driver_and_answers_over_its_wire(config: StationConfig) -> None:
    cell = job_cell(config, LAB, 7401)
    prompts: list[str] = []
    with EmulatedLab(cell, prompts.append, FACTOR, "ideal") as lab:
        station = lab.station
        assert isinstance(station.arm, UnsupervisedUrArm)
        assert config.calibration is not None
        assert station.robot_serial == config.calibration.robot_serial
        assert station.camera_serial == config.calibration.camera_serial
        frame = station.camera.read()
        assert frame.intrinsics.agrees(config.camera.intrinsics)
        assert np.mean(frame.depth > 0.0) > 0.8
        assert station.clock.now() - frame.stamp < 0.5
        assert not station.person.zone_occupied(), "the door is closed"
        assert not station.person.hold_to_run_held()
        assert station.person.hold_switch("hold it", 10.0)
        assert station.person.hold_to_run_held()
        assert station.person.confirm_swing("is everybody out?", 10.0)
        assert not station.person.hold_to_run_held(), "both hands were needed"
        assert station.person.take_tool("take it", 10.0)
        assert station.person.zone_occupied(), "the door is open"
        assert station.arm.state().status is ArmStatus.SAFEGUARD_STOP, "which is on the safeguard, too"
        assert station.person.release("step back", 10.0)
        assert not station.person.zone_occupied(), "the door is closed"
        assert station.arm.state().status is ArmStatus.READY
        station.arm.reset()
        np.testing.assert_allclose(station.arm.state().joints.q, config.scene.home, atol=0.01)
    assert len(prompts) == 4


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("name", "driver", "port", "factor"),
    [
        # The contract, their drivers' tests and rows are in every run; nightly these.
        pytest.param("inspire", InspireHand, "/dev/ttyUSB0", FACTOR, marks=pytest.mark.nightly),
        pytest.param("inspire", InspireHand, "tcp://192.168.11.210:6000", FACTOR, marks=pytest.mark.nightly),
        pytest.param("ability", AbilityHand, "/dev/ttyUSB0", FACTOR, marks=pytest.mark.nightly),
        # Its fingers wait for the thumb, slowly.
        pytest.param("shadow", ShadowHand, "ws://192.168.1.20:9090", 0.25, marks=pytest.mark.nightly),
    ],
)
def test_the_emulated_fingers_hold_what_the_person_puts_between_them(
    config: StationConfig, name: str, driver: type[Any], port: str, factor: float
) -> None:
    config = _at_the_handover(_with_hand(config, name, port))
    cell = job_cell(config, LAB, 7401)
    with EmulatedLab(cell, print, factor, "ideal") as lab:
        hand, person = lab.station.hand, lab.station.person
        assert isinstance(hand, driver)
        hand.open()
        hand.close()
        assert not hand.state().holding, "there is nothing in it"
        hand.open()
        assert person.request_handover("lay it in", 20.0)
        hand.close()
        assert hand.state().holding
        assert person.release("step back", 20.0)
        lab.station.clock.sleep(1.0)
        state = hand.state()
        assert state.holding
        assert not state.fault
        lifted = lab.judge.X_hand_ee(lab.station.clock.now())
        assert np.linalg.norm(lifted[:3, 3]) < 0.5, "it is still in the hand"


class UntoldLens:
    """A camera whose driver does not tell its lens."""

    def __init__(self, config: StationConfig) -> None:
        self._intrinsics, self._rng = config.camera.intrinsics, np.random.default_rng(0)

    def open(self) -> CameraProfile:
        return CameraProfile("camera", "832112070123", Lens(self._intrinsics, LensModel.UNKNOWN), 30.0)

    def fetch(self, timeout: float) -> RawImages:
        time.sleep(min(timeout, 1.0 / 30.0))
        size, stamp = (self._intrinsics.height, self._intrinsics.width), time.monotonic()
        rgb = self._rng.integers(0, 255, (*size, 3), np.uint8)
        return RawImages(rgb, self._rng.uniform(0.5, 1.0, size).astype(np.float32), stamp, stamp)

    def close(self) -> None: ...


def test_a_camera_whose_lens_nobody_knows_is_not_calibrated(config: StationConfig) -> None:
    lab = LabStation(config, print, purpose=Purpose.CALIBRATION, stream=UntoldLens(config))
    with raises(NotReadyError, "not_ready.camera_lens_unknown") as caught, lab:
        pass
    assert "camera.distortion" in str(caught.value)
    told = replace(config, camera=replace(config.camera, distortion=(0.0, 0.0, 0.0, 0.0)))
    arm = replace(told.arm, host="127.0.0.99")  # nobody is there: what is refused next
    lab = LabStation(replace(told, arm=arm), print, purpose=Purpose.CALIBRATION, stream=UntoldLens(config))
    with pytest.raises(DeviceError), lab:
        pass


def _driver(config: StationConfig, name: str) -> StationConfig:
    assert config.camera.device is not None
    return replace(config, camera=replace(config.camera, device=replace(config.camera.device, driver=name)))


def _with_hand(config: StationConfig, name: str, port: str | None) -> StationConfig:
    other = load_station(EXAMPLES / f"{name}.yaml")
    hand = replace(other.hand, port=port, weighed=HandWeight(0.9, (0.0, 0.0, 0.06)))
    return replace(config, hand=hand, strike=other.strike)


def _at_the_handover(config: StationConfig) -> StationConfig:
    """The station whose arm begins where tools are handed over: nothing there is in the tool's way into the hand."""
    robot = RobotModel.of_station(config)
    q_open = robot.description.hand_open
    world = CollisionWorld(robot, config, q_open)
    home = plan_handover(robot, config, world, np.array(config.scene.home), q_open).q[-1]
    return replace(config, scene=replace(config.scene, home=tuple(home.tolist())))
