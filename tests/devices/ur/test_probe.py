"""The probe reads a controller without moving it; each thing that can be wrong with a robot is found before motion."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from toolee_robot.devices.ur.checks import UrExpected, check
from toolee_robot.devices.ur.probe import UrReport, probe
from toolee_robot.devices.ur.setup_checks import calibration_of
from toolee_robot.findings import Finding, Level
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, Payload

pytestmark = pytest.mark.sim

_HOSTS = {ArmModel.UR10: "127.0.0.42", ArmModel.UR10E: "127.0.0.43"}
_PAYLOAD = Payload(5.0, np.array([0.0, 0.0, 0.15]))
_LISTEN = 0.15  # [s]


@pytest.fixture(scope="module")
def controllers() -> Iterator[dict[ArmModel, ControllerProcess]]:
    with ExitStack() as stack:
        yield {m: stack.enter_context(ControllerProcess(model=m, host=host)) for m, host in _HOSTS.items()}


@pytest.fixture(params=list(ArmModel))
def robot(controllers: dict[ArmModel, ControllerProcess], request: pytest.FixtureRequest) -> ControllerProcess:
    """As it should be: the hand's payload set, the TCP at the flange."""
    controller = controllers[request.param]
    controller.fault("reset")
    controller.fault("payload", mass=_PAYLOAD.mass, cog=_PAYLOAD.center_of_mass.tolist())
    controller.fault("tcp", pose=[0.0] * 6)
    return controller


def _model(robot: ControllerProcess) -> ArmModel:
    return ArmModel(robot.options.model)


def _expected(robot: ControllerProcess, **changes: Any) -> UrExpected:
    return replace(UrExpected(_model(robot), payload=_PAYLOAD, tcp=np.zeros(6)), **changes)


def _found(robot: ControllerProcess, **changes: Any) -> dict[str, Finding]:
    findings = check(probe(robot.host, listen=_LISTEN), _expected(robot, **changes))
    by_name = {f.name: f for f in findings}
    assert len(by_name) == len(findings), "names are unique"
    assert all(f.message for f in findings)
    assert all(bool(f.remedy) == (f.level is not Level.OK) for f in findings), "what is not well says what to do"
    return by_name


def test_the_accelerometer_feels_gravity_in_the_tools_axes(robot: ControllerProcess) -> None:
    report = probe(robot.host, listen=_LISTEN)
    assert report.state is not None
    assert report.state.accelerometer is not None
    R = DhParameters.of(_model(robot)).fk(report.state.q)[:3, :3]
    np.testing.assert_allclose(R @ report.state.accelerometer, [0.0, 0.0, 9.82], atol=1e-9)
    robot.fault("missing", variables=["actual_tool_accelerometer"])
    report = probe(robot.host, listen=_LISTEN)
    assert report.state is not None
    assert report.state.accelerometer is None


def test_a_robot_as_it_should_be(robot: ControllerProcess) -> None:
    before = robot.state()
    serial = probe(robot.host, listen=_LISTEN).serial
    found = _found(robot, serial=serial)
    # Timing is this machine's: everything else must be well.
    assert {f.name for f in found.values() if f.level is not Level.OK} <= {"RTDE jitter", "clock", "network"}
    assert found["network"].level is not Level.FAIL
    assert found["robot model"].message.startswith(_model(robot))
    after = robot.state()
    assert after["uploads"] == before["uploads"], "no script was uploaded"
    assert after["q"] == before["q"]
    assert after["program_state"] == before["program_state"]
    for _ in range(50):  # the controller may need a few ticks to notice
        if not any(n for port, n in robot.state()["clients"].items() if port != "faults"):
            break
        time.sleep(0.02)
    else:
        pytest.fail(f"connections were left open: {robot.state()['clients']}")


def test_what_is_read(robot: ControllerProcess) -> None:
    tcp = [0.01, -0.02, 0.1, 0.0, 0.3, 0.0]
    robot.fault("tcp", pose=tcp)
    robot.fault("speed_slider", fraction=0.6)
    report = probe(robot.host)
    truth = robot.state()
    assert report.state is not None
    np.testing.assert_allclose(report.state.q, truth["q"], atol=1e-9)
    np.testing.assert_allclose(report.state.tcp_pose, truth["tcp_pose"], atol=1e-9)
    assert report.state.tcp_offset is not None
    np.testing.assert_allclose(report.state.tcp_offset, tcp, atol=1e-12)
    assert report.state.payload is not None
    assert report.state.payload.mass == pytest.approx(5.0)
    np.testing.assert_allclose(report.state.payload.center_of_mass, _PAYLOAD.center_of_mass, atol=1e-12)
    assert report.state.speed_slider == pytest.approx(0.6)
    assert report.model == "UR10", "the dashboard does not tell the generations apart"
    assert report.version is not None
    assert report.version[0] == (5 if _model(robot) is ArmModel.UR10E else 3)
    assert report.quality is not None
    rate = 500.0 if _model(robot) is ArmModel.UR10E else 125.0
    assert report.quality.asked == rate
    assert report.quality.rate == pytest.approx(rate, rel=0.01)
    assert report.quality.samples > 0.3 * rate
    assert report.quality.clock_ratio == pytest.approx(1.0, abs=0.3)
    assert report.problems == ()


_FAULTS: list[tuple[str, dict[str, Any], str, Level, str]] = [
    ("payload", {"mass": 1.5, "cog": [0.0, 0.0, 0.15]}, "payload", Level.FAIL, "1.50 kg"),
    ("payload", {"mass": 5.0, "cog": [0.0, 0.0, 0.05]}, "payload", Level.FAIL, "50) mm"),
    ("tcp", {"pose": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]}, "TCP", Level.FAIL, "100.0) mm"),
    ("tcp", {"pose": [0.0, 0.0, 0.0, 0.0, 0.0, 0.1]}, "TCP", Level.FAIL, "5.7°"),
    ("version", {"version": [3, 3, 0, 1]}, "controller version", Level.FAIL, "3.3.0.1"),
    ("version", {"version": [10, 7, 0, 1]}, "controller version", Level.FAIL, "10.7.0.1"),
    ("model", {"name": "UR5"}, "robot model", Level.FAIL, "UR5"),
    ("speed_slider", {"fraction": 0.5}, "speed slider", Level.FAIL, "50%"),
    ("speed_slider", {"fraction": 0.0}, "speed slider", Level.FAIL, "0%"),
    ("protective_stop", {}, "safety", Level.FAIL, "protective stop"),
    ("emergency_stop", {}, "safety", Level.FAIL, "robot emergency stop"),
    ("emergency_stop", {"system": True}, "safety", Level.FAIL, "system emergency stop"),
    ("safeguard_stop", {}, "safety", Level.FAIL, "safeguard stop"),
    ("safety_fault", {}, "safety", Level.FAIL, "fault"),
    ("safety_fault", {"violation": True}, "safety", Level.FAIL, "violation"),
    ("kinematics", {"a": [0, 2e-3, -1e-3, 0, 0, 0], "d": [1e-3] + [0] * 5}, "kinematics", Level.WARN, "nominal"),
    ("kinematics", {"a": [0, 0.05, 0, 0, 0, 0], "d": [0] * 6}, "kinematics", Level.FAIL, "mm off"),
    ("missing", {"variables": ["payload", "payload_cog"]}, "payload", Level.WARN, "does not report"),
    ("missing", {"variables": ["tcp_offset"]}, "TCP", Level.WARN, "does not report"),
    ("missing", {"variables": ["actual_q"]}, "RTDE", Level.FAIL, "actual_q"),
    ("nan", {"variables": ["actual_q"], "ticks": 10_000}, "RTDE", Level.FAIL, "not finite"),
    ("nan", {"variables": ["tcp_offset"], "ticks": 10_000}, "RTDE", Level.FAIL, "not finite"),
    ("freeze_timestamp", {}, "RTDE rate", Level.FAIL, "0.0 Hz"),
    ("refuse", {"port": "rtde"}, "network", Level.FAIL, "30004"),
    ("refuse", {"port": "realtime"}, "network", Level.FAIL, "30003"),
    ("refuse", {"port": "all"}, "network", Level.FAIL, "no robot"),
    ("refuse", {"port": "dashboard"}, "network", Level.FAIL, "29999"),
    ("serial", {"number": "20199999999"}, "serial number", Level.FAIL, "20199999999"),
    ("reboot", {"seconds": 0.0}, "robot mode", Level.FAIL, "power off"),
]


@pytest.mark.parametrize(
    ("robot", "fault", "arguments", "name", "level", "expected_text"),
    [(list(ArmModel)[i % 2], *row) for i, row in enumerate(_FAULTS)],  # in turn: none concerns one model alone
    indirect=["robot"],
)
def test_each_fault_is_found(
    robot: ControllerProcess, fault: str, arguments: dict[str, Any], name: str, level: Level, expected_text: str
) -> None:
    robot.fault(fault, **arguments)
    time.sleep(0.05)
    finding = _found(robot, serial="20185500001")[name]
    assert finding.level is level, finding
    assert expected_text in finding.message, finding


def test_local_control_is_found_on_an_e_series_and_does_not_exist_on_a_cb3(robot: ControllerProcess) -> None:
    robot.fault("remote", remote=False)
    finding = _found(robot)["remote control"]
    assert finding.level is (Level.FAIL if _model(robot) is ArmModel.UR10E else Level.OK)


def test_the_other_model_is_found_by_its_controller_and_by_its_kinematics(robot: ControllerProcess) -> None:
    other = next(m for m in ArmModel if m is not _model(robot))
    found = _found(robot, model=other)
    assert found["robot model"].level is Level.FAIL
    assert found["kinematics"].level is Level.FAIL
    assert f"{_model(robot)} fits to 0.0 mm" in found["kinematics"].message


def test_without_the_primary_interface_one_posture_tells_the_model(robot: ControllerProcess) -> None:
    robot.fault("refuse", port="primary")
    other = next(m for m in ArmModel if m is not _model(robot))
    assert _found(robot)["kinematics"].level is Level.OK
    wrong = _found(robot, model=other)["kinematics"]
    assert wrong.level is Level.FAIL
    assert "in this posture" in wrong.message


def test_an_arms_own_calibration_fits_it_and_no_other(robot: ControllerProcess) -> None:
    robot.fault("kinematics", a=[0, 2e-3, -1e-3, 0, 0, 0], d=[1e-3, 0, 0, -1e-3, 0, 0])
    report = probe(robot.host, listen=_LISTEN)
    assert report.kinematics is not None
    own = calibration_of(report.kinematics.dh, _model(robot))
    np.testing.assert_allclose(own.delta_a, [0, 2e-3, -1e-3, 0, 0, 0], atol=1e-12)
    assert _found(robot, calibration=own)["kinematics"].level is Level.OK
    robot.fault("kinematics", a=[0] * 6, d=[0] * 6)
    wrong = _found(robot, calibration=own)["kinematics"]
    assert wrong.level is Level.FAIL
    assert "another arm" in wrong.remedy


def test_a_program_and_a_moving_arm_are_found(robot: ControllerProcess) -> None:
    with socket.create_connection((robot.host, 30003), 5.0) as script:
        script.sendall(b"def spin():\n  speedj([0, 0, 0, 0, 0, 0.3], 2.0, 10.0)\nend\n")
        deadline = time.monotonic() + 10.0
        while robot.state()["qd"][5] < 0.25:
            assert time.monotonic() < deadline, robot.state()
            time.sleep(0.02)
        found = _found(robot)
    assert found["standstill"].level is Level.FAIL
    assert "0.30 rad/s" in found["standstill"].message
    assert found["program"].level is Level.WARN


@pytest.fixture(scope="module")
def report() -> UrReport:
    with ControllerProcess(model="UR10", host="127.0.0.44") as process:
        return probe(process.host, listen=0.5)


@pytest.mark.parametrize(
    ("change", "name", "level"),
    [
        ({}, "RTDE jitter", Level.OK),
        ({"gap_p99": 0.020}, "RTDE jitter", Level.WARN),
        ({"lost": 3}, "RTDE jitter", Level.WARN),
        ({"lost": 300}, "RTDE jitter", Level.FAIL),
        ({"backward": 1}, "RTDE jitter", Level.FAIL),
        ({"rate": 62.5}, "RTDE rate", Level.FAIL),
        ({"rate": float("nan")}, "RTDE rate", Level.FAIL),
        ({"clock_ratio": 0.97}, "clock", Level.WARN),
        ({"clock_ratio": 1.4}, "clock", Level.FAIL),
        ({"clock_ratio": float("nan")}, "clock", Level.FAIL),
    ],
)
def test_bad_data_is_found(report: UrReport, change: dict[str, Any], name: str, level: Level) -> None:
    assert report.quality is not None
    well = replace(report.quality, samples=500, rate=125.0, lost=0, backward=0, gap_p99=8.2e-3, clock_ratio=1.0)
    found = {f.name: f for f in check(replace(report, quality=replace(well, **change)), UrExpected(ArmModel.UR10))}
    assert found[name].level is level


@pytest.mark.parametrize(
    ("version", "level"),
    [
        ((3, 15, 8, 1), Level.OK),
        ((3, 14, 3, 1), Level.WARN),
        ((3, 3, 9, 1), Level.FAIL),
        ((5, 10, 2, 1), Level.WARN),
        ((5, 22, 0, 1), Level.OK),
        ((5, 23, 0, 1), Level.WARN),
        ((10, 3, 0, 1), Level.FAIL),
    ],
)
def test_versions(report: UrReport, version: tuple[int, int, int, int], level: Level) -> None:
    found = {f.name: f for f in check(replace(report, version=version), UrExpected(ArmModel.UR10))}
    assert found["controller version"].level is level


def test_no_robot_at_all_is_said_at_once() -> None:
    began = time.monotonic()
    findings = check(probe("127.0.0.45"), UrExpected(ArmModel.UR10))
    assert [(f.name, f.level) for f in findings] == [("network", Level.FAIL)]
    assert "no robot at 127.0.0.45" in findings[0].message
    assert time.monotonic() - began < 3.0


def test_a_silent_host_does_not_hold_us_up() -> None:
    with ExitStack() as stack:
        for port in (29999, 30001, 30002, 30003, 30004):
            listener = stack.enter_context(socket.socket())
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(("127.0.0.46", port))
            listener.listen(8)
        began = time.monotonic()
        report = probe("127.0.0.46", timeout=1.0)
        assert time.monotonic() - began < 3.0
    findings = {f.name: f for f in check(report, UrExpected(ArmModel.UR10))}
    assert findings["RTDE"].level is Level.FAIL
    assert "no answer in time" in findings["RTDE"].message
    assert findings["dashboard"].level is Level.WARN


def test_joints_that_the_robot_restricts_more_than_the_plan_are_named(robot: ControllerProcess) -> None:
    velocity = sim_station().arm.velocity
    assert _found(robot, velocity=velocity)["joint limits"].level is Level.OK
    report = probe(robot.host, listen=_LISTEN)
    assert report.kinematics is not None
    ranges = report.kinematics.ranges
    assert ranges is not None
    np.testing.assert_allclose(ranges.speed, 1.1 * np.array(velocity), rtol=0.01)
    np.testing.assert_allclose([-ranges.lower, ranges.upper], 2.0 * np.pi)
    restricted = replace(ranges, speed=ranges.speed * [1, 1, 0.5, 1, 1, 1], lower=ranges.lower * [1, 1, 1, 0.25, 1, 1])
    report = replace(report, kinematics=replace(report.kinematics, ranges=restricted))
    found = {f.name: f for f in check(report, _expected(robot, velocity=velocity))}["joint limits"]
    assert found.level is Level.WARN
    assert "elbow 99°/s, arm.velocity has 180°/s" in found.message
    assert "wrist 1 -90° to 360°" in found.message
