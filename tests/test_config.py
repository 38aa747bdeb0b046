"""A station file is read strictly: what is not understood is named, with the file."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.errors import raises
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.errors import ConfigError
from toolee_robot.station import (
    MEASURED,
    SIMULATED,
    CalibrationConfig,
    ServoConfig,
    load_lab_station,
    load_station,
    servo_lag,
    sim_station,
    unmeasured,
)


def _write(folder: Path, text: str) -> Path:
    path = folder / "lab.yaml"
    path.write_text(text)
    return path


def test_a_subset_of_the_fields_is_enough(tmp_path: Path) -> None:
    config = load_station(
        _write(
            tmp_path, "frame: base_link\nwork: {nail_xy: [0.6, 0.2], nail_diameter: 0.003}\ntask: {max_strikes: 7}\n"
        )
    )
    assert config.work.nail_xy == (0.6, 0.2)
    assert config.task.max_strikes == 7
    assert config.camera == sim_station().camera


def test_one_acceleration_is_that_of_every_joint(tmp_path: Path) -> None:
    assert load_station(_write(tmp_path, "arm: {acceleration: 4.0}")).arm.acceleration == (4.0,) * 6
    each = load_station(_write(tmp_path, "arm: {acceleration: [5, 5, 10, 15, 15, 15]}")).arm.acceleration
    assert each == (5.0, 5.0, 10.0, 15.0, 15.0, 15.0)


def test_the_servo_is_universal_robots_own_until_the_file_says_otherwise(tmp_path: Path) -> None:
    assert (sim_station().servo.gain, sim_station().servo.lookahead) == (300.0, 0.1)
    servo = load_station(_write(tmp_path, "servo: {gain: 1200, lookahead: 0.03, lag: 0.034}\n")).servo
    assert (servo.gain, servo.lookahead, servo_lag(servo, 500.0)) == (1200.0, 0.03, 0.034)


@pytest.mark.parametrize("servo", [ServoConfig(gain=50.0), ServoConfig(lookahead=0.3), ServoConfig(link_timeout=2.5)])
def test_a_servo_that_the_controller_does_not_take_is_refused_by_its_driver(servo: ServoConfig) -> None:
    with raises(ConfigError, code="config.servo"):
        UrArmConfig("127.0.0.2", servo)


@pytest.mark.parametrize(("rate", "measured"), [(500.0, 0.034), (125.0, 0.054)])
def test_the_assumed_lag_bounds_what_was_measured_elsewhere(rate: float, measured: float) -> None:
    assert measured < servo_lag(ServoConfig(gain=1200.0, lookahead=0.03), rate) < 2.0 * measured


@pytest.mark.parametrize(
    ("record", "devices", "today", "expected_text"),
    [
        ({}, ("R1", "C1"), "2026-05-20", []),
        ({}, ("R1", "C1"), "2026-06-19", []),
        ({}, ("R1", "C1"), "2026-06-20", ["31 days old"]),
        ({"valid_days": None}, ("R1", "C1"), "2036-06-20", []),
        ({}, ("R1", "C1"), "2026-05-19", []),  # measured where it is a day later already
        ({}, ("R1", "C1"), "2026-05-18", ["in the future"]),
        ({}, ("R2", "C1"), "2026-05-20", ["robot 'R1'"]),
        ({}, ("", ""), "2026-05-20", ["robot", "camera"]),
        ({}, ("R1", "C2"), "2026-05-20", ["camera 'C1'"]),
        ({"residual": 0.005}, ("R1", "C1"), "2026-05-20", ["5.0 mm"]),
    ],
)
def test_a_calibration_is_for_one_robot_one_camera_and_some_weeks(
    record: dict[str, float | None], devices: tuple[str, str], today: str, expected_text: list[str]
) -> None:
    calibration = CalibrationConfig(**{"measured_on": "2026-05-20", "robot_serial": "R1", "camera_serial": "C1",
                                       "residual": 0.001, **record})  # type: ignore[arg-type]  # fmt: skip
    problems = calibration.problems(*devices, date.fromisoformat(today))
    assert len(problems) == len(expected_text)
    assert all(expected in problem for expected, problem in zip(expected_text, problems, strict=True))


def test_the_default_station_is_calibrated_for_the_simulated_devices_and_no_others(tmp_path: Path) -> None:
    calibration = sim_station().calibration
    assert calibration is not None
    assert calibration.problems(SIMULATED, SIMULATED, date(2040, 1, 1)) == []
    assert len(calibration.problems("20235012345", "F1370001", date(2026, 11, 20))) == 2
    assert load_station(_write(tmp_path, "calibration: null")).calibration is None


MEASURED_FILE = Path(__file__).parent.parent / "examples" / "lab.yaml"


def _whole_station() -> dict[str, Any]:
    """The example of a lab, with a hand, which is weighed as a whole, instead of its mount."""
    data: dict[str, Any] = yaml.safe_load(MEASURED_FILE.read_text())
    data["hand"] = {
        "model": "shadow_right", "weighed": {"mass": 5.011, "center_of_mass": [-0.0049, -0.0022, 0.1532]}
    }  # fmt: skip
    return data


def test_the_example_of_a_lab_gives_what_a_lab_must_measure(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(_whole_station()))
    assert unmeasured(path) == []
    assert load_lab_station(path).calibration is not None


@pytest.mark.parametrize(("section", "name"), [(s, n) for s, names in MEASURED.items() for n in names])
def test_a_robots_station_file_without_a_measured_field_is_refused_by_its_name(
    tmp_path: Path, section: str, name: str
) -> None:
    data = _whole_station()
    del data[section][name]
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(data))
    with raises(ConfigError) as caught:
        load_lab_station(path)
    assert f"give {section}.{name}" in str(caught.value)


LINES = """\
# A lab.
frame: base_link
work:
  nail_length: 2,2 mm
  nail_xy:
    - 0.7
    - left
tool: {name: claw}
camera:
  fx: 600.0
  width: 0.4
  target:
"""


def test_what_is_wrong_or_missing_in_a_file_is_said_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(LINES)
    with raises(ConfigError) as caught:
        load_station(path)
    told = {line.split(":")[0].strip(): line for line in str(caught.value).splitlines()}
    assert told["work.nail_length"].endswith("(line 4)")
    assert told["work.nail_xy.1"].endswith("(line 7)")
    assert told["tool.mass"].endswith("is missing (`tool` begins in line 8)")
    assert told["camera.width"].endswith("(line 11)")


def test_the_lines_of_what_a_lab_must_measure_and_of_other_units_are_said(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    text = yaml.safe_dump(_whole_station(), sort_keys=False)
    lines = text.splitlines()
    begins = {name: 1 + lines.index(f"{name}:") for name in ("camera", "work")}
    data = _whole_station()
    for name in ("nail_diameter", "nail_length"):
        del data["work"][name]
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    with raises(ConfigError) as caught:
        load_lab_station(path)
    assert f"work.nail_diameter, work.nail_length (`work` begins in line {begins['work']});" in str(caught.value)
    at = 1 + next(i for i, line in enumerate(lines) if line.startswith("  fx:"))
    data = _whole_station()
    data["camera"]["fx"] = None
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    with raises(ConfigError) as caught:
        load_lab_station(path)
    assert f"camera.fx: line {at}" in str(caught.value)
    data["camera"]["fx"] = 0.4
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    with raises(ConfigError) as caught:
        load_lab_station(path)
    assert f"20000 px (line {at})" in str(caught.value)
    del data["scene"]
    data["camera"]["fx"] = 600.0
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    with raises(ConfigError) as caught:
        load_lab_station(path)
    assert "scene.workspace_upper; `toolee" in str(caught.value), "a section that is not there has no line"


def test_a_file_that_is_not_there_names_the_interview(tmp_path: Path) -> None:
    with raises(ConfigError) as caught:
        load_station(tmp_path / "lab.yaml")
    assert "toolee station new" in str(caught.value)
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n")
    with raises(ConfigError) as caught:
        load_station(tmp_path / "picture.png")
    assert "not UTF-8" in str(caught.value)
