"""Every number of the station file has a unit and both ends of a range: what cannot be is refused, field by field."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.errors import raises
from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_files import name_in_file
from toolee_robot.station import StationConfig, load_station, sim_station
from toolee_robot.station.schema import StationField, record_fields

EXAMPLES = Path(__file__).parents[1] / "examples"
NUMBERS = [field for field in record_fields(StationConfig) if field.unit is not None]
"""Every field that is a number, or several. The camera's whole pose has checks of its own, test_camera_pose.py."""
ZERO_IS_A_VALUE = {
    "up", "position", "target", "handle", "working_side", "center_of_mass", "body_position", "hinge_position",
    "hinge_axis", "fingers", "thumb", "delta_theta", "delta_a", "delta_d", "delta_alpha", "distortion", "table_center",
    "table_height", "person_center", "home", "handover_position", "handover_facing", "workspace_lower",
    "workspace_upper", "center", "rotation", "nail_xy", "xy", "stand_height", "block_xy", "block_turn", "wood_rise",
    "nail_lean", "lean", "face", "face_normal", "pilot_hole_diameter", "residual", "stiffness", "door_closed_input",
    "door_open_input", "hold_to_run_input", "hold_to_run_released_input",
}  # fmt: skip
"""Coordinates, angles, directions, inputs, and what may not be there: all others are refused 1,000 times too small."""
FILES = ("lab", "inspire", "ability", "shadow", "nails")


def _values(record: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """What a station says, by the names of the fields."""
    for field in fields(record):
        value, name = getattr(record, field.name), name_in_file(field)
        for part in value if isinstance(value, tuple) and value and is_dataclass(value[0]) else (value,):
            if is_dataclass(part):
                yield from _values(part, (*path, name if part is value else f"{name}[]"))
            elif name and part is not None:
                yield ".".join((*path, name)), part


@pytest.fixture(scope="module")
def real() -> dict[str, list[float]]:
    """Numbers of whole stations, by field."""
    found: dict[str, list[float]] = {}
    for station in (sim_station(), *(load_station(EXAMPLES / f"{name}.yaml") for name in FILES)):
        for name, value in _values(station):
            found.setdefault(name, []).extend(value if isinstance(value, tuple) else [value])
    return found


def _refusal(field: StationField, value: Any, path: Path) -> str:
    """Why a station file with a value of a field is refused; of a list, with the value in its first place."""
    data: Any = [value, *[0.5] * (field.numbers - 1)] if field.numbers else value
    for name in reversed(field.path):
        data = {name.removesuffix("[]"): [data] if name.endswith("[]") else data}
    path.write_text(yaml.safe_dump({"frame": "base_link", **data}))
    with raises(ConfigError, code="config.invalid") as refused:
        load_station(path)
    name = field.name.replace("[]", ".0") + (".0" if field.numbers else "")
    return next(line for line in str(refused.value).splitlines() if line.strip().startswith(f"{name}:"))


@pytest.mark.parametrize("field", NUMBERS, ids=lambda field: field.name)
def test_a_number_that_cannot_be_is_refused_with_its_unit_its_range_and_its_line(
    field: StationField, real: dict[str, list[float]], tmp_path: Path
) -> None:
    unit, whole, path = field.unit, real.get(field.name, []), tmp_path / "lab.yaml"
    assert unit is not None
    wrong: list[Any] = [1e6, -1e6, float("nan"), float("inf"), "wide", True, False, "0x10"]
    wrong += [v * 1000 for v in whole if not unit.low <= v * 1000 <= unit.high]
    if unit.low >= 0:
        wrong += [-value for value in whole if value]
        wrong += [value / 1000 for value in whole if value and unit.low > 0]
    if unit.low > 0:
        wrong.append(0)
    for value in wrong:
        said = _refusal(field, value, path)
        assert unit.range in said
        assert "line" in said


def test_a_thousand_times_too_large_is_refused_everywhere(real: dict[str, list[float]]) -> None:
    units = {field.name: field.unit for field in NUMBERS}
    accepted = {
        name
        for name, unit in units.items()
        for value in real.get(name, [])
        if value and unit is not None and unit.low <= abs(value) * 1000 <= unit.high
    }
    assert accepted == set()
    about_nothing = {name.rpartition(".")[2] for name, unit in units.items() if unit is not None and unit.low <= 0}
    assert about_nothing == ZERO_IS_A_VALUE


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("supervisor: {handover_speed: 250}", "millimetres per second"),
        ("supervisor: {unattended_speed: 1500}", "millimetres per second"),
        ("supervisor: {tracking_error: 1000000}", "0.001 to 0.5 rad"),
        ("supervisor: {max_data_age: 1000000}", "0.005 to 1 s"),
        ("servo: {watchdog: 0.1}", "the arm goes on for 1/watchdog s"),
        ("servo: {lag: 70}", "milliseconds"),
        ("servo: {heartbeat_timeout: 100}", "milliseconds"),
        ("tool_envelope: {head_radius: 33}", "millimetres"),
        ("tool_envelope: {head_radius: 0.000033}", "0.005 to 0.1 m"),
        ("strike: {touch_force: 1000000}", "0.5 to 100 N"),
        ("scene: {home: [0, -110, 110, -90, -90, 0]}", "degrees"),
        ("tool: {mass: 550}", "grams"),
        ("camera: {cx: 64}", "far from the middle"),
        ("camera: {fy: 900}", "pixels are about square"),
        ("camera: {fx: 50, fy: 50}", "no focal length of a 512 px wide image"),
    ],
)
def test_a_typing_error_is_named(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    with raises(ConfigError, code="config.invalid") as refused:
        load_station(path)
    assert said in str(refused.value)
    assert "line 1" in str(refused.value)
