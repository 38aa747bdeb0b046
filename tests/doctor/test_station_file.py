"""What the doctor says of a station file: figures that do not fit together, a calibration of something else."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest

from tests.examples import seldom
from toolee_robot.doctor.configuration import check_calibration, check_contacts, check_limits, check_reach, check_sides
from toolee_robot.doctor.machine import check_weights
from toolee_robot.findings import Finding, Level
from toolee_robot.station import (
    SIMULATED,
    SIMULATED_CALIBRATION,
    CalibrationConfig,
    NailConfig,
    PersonConfig,
    StationConfig,
    sim_station,
)
from toolee_robot.types import ArmModel

_TODAY = date(2026, 11, 20)
_CALIBRATION = CalibrationConfig("2026-11-10", "2018550001", "cam7", 0.0012)


def _changed(section: str, **changes: Any) -> StationConfig:
    config = sim_station()
    return replace(config, **{section: replace(getattr(config, section), **changes)})


def _only(findings: list[Finding]) -> Finding:
    assert len(findings) == 1, findings
    return findings[0]


@pytest.mark.parametrize("model", seldom(*ArmModel))
def test_the_shipped_station_is_well(model: ArmModel) -> None:
    config = _changed("arm", model=model)
    findings = [check_sides(config), *check_limits(config), *check_reach(config)]
    assert {f.level for f in findings} == {Level.OK}, findings
    assert all(f.message and not f.remedy for f in findings)


@pytest.mark.parametrize(
    ("section", "changes", "name", "level", "expected_text"),
    [
        ("arm", {"velocity": (2.09, 2.09, 3.5, 3.14, 3.14, 3.14)}, "limits", Level.FAIL, "elbow_joint is 3.50 rad/s"),
        ("scene", {"home": (0.0, -1.9, 7.0, -1.57, -1.57, 0.0)}, "limits", Level.FAIL, "scene.home puts elbow_joint"),
        ("scene", {"handover_position": (0.4, -1.3, 0.65)}, "limits", Level.FAIL, "outside the workspace"),
        ("supervisor", {"handover_speed": 0.4}, "handover speed", Level.WARN, "0.4 m/s"),
        ("supervisor", {"unattended_speed": 2.5}, "swing speed", Level.WARN, "2.5 m/s"),
    ],
)
def test_limits_that_do_not_fit(
    section: str, changes: dict[str, Any], name: str, level: Level, expected_text: str
) -> None:
    found = {f.name: f for f in check_limits(_changed(section, **changes))}
    assert found[name].level is level
    assert expected_text in found[name].message
    assert found[name].remedy


NAIL, HANDOVER = {"nail_xy": (-0.75, -0.10)}, {"handover_position": (-0.40, 0.45, 0.65)}
CAMERA = {"position": (-0.95, 0.62, 0.85), "target": (-0.60, 0.15, 0.72)}
NAILS = (NailConfig("a", (-0.75, -0.10)), NailConfig("b", (-0.75, -0.06)), NailConfig("c", (-0.71, -0.08)))
OVERHEAD = {"position": (-0.05, 0.0, 1.8), "target": (0.6, -0.15, 0.72)}


@pytest.mark.parametrize(
    ("changes", "behind", "remedy"),
    [
        ({}, None, ""),
        ({"work": {"nail_xy": (0.10, 0.75)}}, None, ""),
        ({"work": NAIL}, "work.nail_xy: behind", "it is typed in the other base's frame"),
        ({"scene": HANDOVER}, "scene.handover_position: behind", "it is typed in the other base's frame"),
        ({"scene": {"home": (0.0, -1.5708, 0.0, -1.5708, 0.0, 0.0)}, "work": NAIL}, None, ""),
        ({"camera": CAMERA}, "camera: behind", "it is typed in the other base's frame"),
        (
            {"work": NAIL, "scene": HANDOVER, "camera": CAMERA},
            "work.nail_xy, scene.handover_position, camera: behind",
            "`frame` names the other base",
        ),
        (
            {"work": NAIL, "scene": HANDOVER},
            "work.nail_xy, scene.handover_position: behind",
            "they are typed in the other base's frame",
        ),
        (
            {"work": {**NAIL, "nails": NAILS}},
            "work.nails a, work.nails b, work.nails c: behind",
            "they are typed in the other base's frame",
        ),
        ({"camera": OVERHEAD}, None, ""),
        (
            {"work": NAIL, "scene": HANDOVER, "camera": OVERHEAD},
            "work.nail_xy, scene.handover_position: behind",
            "`frame` names the other base",
        ),
    ],
)
def test_what_was_typed_in_the_other_frame_of_the_base_is_behind_the_arm(
    changes: dict[str, dict[str, Any]], behind: str | None, remedy: str
) -> None:
    """`home` are joint positions, which have no frame."""
    config = sim_station()
    for section, fields in changes.items():
        config = replace(config, **{section: replace(getattr(config, section), **fields)})
    finding = check_sides(config)
    assert finding.level is (Level.OK if behind is None else Level.WARN)
    assert (behind or "") in finding.message
    assert remedy in finding.remedy


@pytest.mark.parametrize(
    ("door", "switch", "expected"),
    [
        (1, 3, {"contacts": Level.OK}),
        (None, 3, {"door contacts": Level.WARN}),
        (1, None, {"switch contacts": Level.WARN}),
        (None, None, {"door contacts": Level.WARN, "switch contacts": Level.WARN}),
    ],
)
def test_a_single_contact_is_told_and_does_not_fail(
    door: int | None, switch: int | None, expected: dict[str, Level]
) -> None:
    person = PersonConfig(
        door_closed_input=0, door_open_input=door, hold_to_run_input=2, hold_to_run_released_input=switch
    )
    found = list(check_contacts(replace(sim_station(), person=person)))
    assert {f.name: f.level for f in found} == expected
    for finding in found:
        if finding.level is Level.WARN:
            assert "stuck high or bridged" in finding.message
            assert ("person.door_open_input" in finding.remedy) == (finding.name == "door contacts")
            assert "toolee doctor --inputs" in finding.remedy


def test_a_station_without_inputs_has_no_contacts_to_check() -> None:
    assert not list(check_contacts(sim_station()))


@pytest.mark.parametrize(
    ("section", "changes", "name", "level"),
    [
        ("work", {"nail_xy": (1.5, 0.1)}, "strike", Level.FAIL),
        *seldom(
            ("scene", {"handover_position": (1.1, -1.1, 1.5)}, "handover", Level.FAIL),
            ("camera", {"position": (3.5, -3.0, 2.5)}, "views", Level.FAIL),
            ("arm", {"velocity": (0.3, 0.3, 0.3, 0.3, 0.3, 0.3)}, "strike", Level.WARN),
        ),
    ],
)
def test_what_is_out_of_reach(section: str, changes: dict[str, Any], name: str, level: Level) -> None:
    found = {f.name: f for f in check_reach(_changed(section, **changes))}
    assert found[name].level is level, found
    assert found[name].remedy
    told = "the camera stands at (3.5, -3, 2.5) m and looks along (-0.65, 0.64, -0.4), both in base_link"
    assert (told in found[name].remedy) is (section == "camera"), "as axes that are swapped show"


@pytest.mark.nightly
def test_the_doctor_says_where_a_block_that_is_too_far_away_may_stand() -> None:
    config = _changed("work", nail_xy=(1.35, 0.1))
    found = {f.name: f for f in check_reach(config)}
    assert found["strike"].level is not Level.OK
    told = re.search(r"the nail at \((-?\d\.\d\d), (-?\d\.\d\d)\) in base", found["strike"].remedy)
    assert told is not None, found["strike"].remedy
    x, y = float(told[1]), float(told[2])
    there = {f.name: f for f in check_reach(_changed("work", nail_xy=(x, y)))}
    assert there["strike"].level is Level.OK


@pytest.mark.parametrize(
    ("calibration", "robot", "camera", "level", "expected_text"),
    [
        (SIMULATED_CALIBRATION, SIMULATED, SIMULATED, Level.OK, "residual 0.0 mm"),
        (_CALIBRATION, "2018550001", "cam7", Level.OK, "of 2026-11-10, residual 1.2 mm"),
        (_CALIBRATION, "2018550001", None, Level.WARN, "not compared with the camera"),
        (_CALIBRATION, "2018550002", "cam8", Level.FAIL, "(and 1 more)"),
        (replace(_CALIBRATION, residual=0.009), "2018550001", "cam7", Level.FAIL, "9.0 mm"),
        (None, "2018550001", "cam7", Level.FAIL, "none"),
    ],
)
def test_calibrations(
    calibration: CalibrationConfig | None, robot: str | None, camera: str | None, level: Level, expected_text: str
) -> None:
    config = replace(sim_station(), calibration=calibration)
    finding = check_calibration(config, robot, camera, _TODAY)
    assert finding.level is level
    assert expected_text in finding.message
    assert bool(finding.remedy) == (level is not Level.OK)


def test_an_arm_moves_slowly_without_a_calibration() -> None:
    config = replace(sim_station(), calibration=None)
    finding = check_calibration(config, "2018550001", None, _TODAY, slow=True)
    assert finding.level is Level.WARN
    assert "no job" in finding.message


def test_missing_weights_are_named(tmp_path: Path) -> None:
    finding = check_weights(tmp_path)
    assert finding.level is Level.FAIL
    assert str(tmp_path) in finding.message
    assert check_weights().level is Level.OK


def test_the_shipped_station_with_the_heaviest_hammer_is_what_the_arm_carries() -> None:
    finding = _only(list(check_limits(sim_station())))
    assert "of 10.0 kg payload" in finding.message
