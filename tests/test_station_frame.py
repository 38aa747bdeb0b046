"""A station file names the frame of its positions; one that was read at the pendant becomes the same station."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from tests.examples import examples
from toolee_robot.errors import ConfigError
from toolee_robot.frames import HALF_TURN, transform
from toolee_robot.runtime.yaml_files import name_in_file
from toolee_robot.station import (
    ArmLimits,
    CameraConfig,
    Obstacle,
    SceneConfig,
    StationConfig,
    WorkConfig,
    load_station,
    sim_station,
)
from toolee_robot.station.head import BOX, OBSTACLES, POINTS, POSE
from toolee_robot.station.schema import StationField, field_docs, record_fields

SECTIONS = {"arm": ArmLimits, "camera": CameraConfig, "work": WorkConfig, "scene": SceneConfig}
_coordinate = st.floats(-1.5, 1.5)
_files = st.fixed_dictionaries(
    {},
    optional={
        "arm": st.fixed_dictionaries({}, optional={"up": st.tuples(*[_coordinate] * 2, st.floats(0.1, 1.0))}),
        "camera": st.fixed_dictionaries({}, optional={"position": st.tuples(*[_coordinate] * 2, st.floats(2.0, 3.0))}),
        "work": st.fixed_dictionaries({}, optional={"nail_xy": st.tuples(_coordinate, _coordinate)}),
        "scene": st.fixed_dictionaries(
            {},
            optional={
                "handover_position": st.tuples(*[_coordinate] * 3),
                "person_center": st.tuples(*[_coordinate] * 3),
                "handover_facing": st.tuples(_coordinate, st.floats(0.1, 1.0), _coordinate),
                "home": st.tuples(*[_coordinate] * 6),
            },
        ),
    },
)


def _load(folder: Path, data: dict[str, Any]) -> StationConfig:
    path = folder / "lab.yaml"
    path.write_text(yaml.safe_dump(_lists(data)))
    return load_station(path)


def _lists(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _lists(value) for key, value in data.items()}
    return list(data) if isinstance(data, tuple) else data


def _at_the_pendant(data: dict[str, Any]) -> dict[str, Any]:
    """What a person reads there for the same points."""
    turned = {section: dict(fields) for section, fields in data.items()}
    for section, name in POINTS:
        if name in turned.get(section, {}):
            x, y, *z = turned[section][name]
            turned[section][name] = (-x, -y, *z)
    return turned


@examples(25)
@given(_files)
def test_a_file_in_either_frame_is_the_same_station(
    tmp_path_factory: pytest.TempPathFactory, data: dict[str, Any]
) -> None:
    folder = tmp_path_factory.mktemp("frames")
    ours = _load(folder, {"frame": "base_link", **data})
    pendants = _load(folder, {"frame": "pendant_base", **_at_the_pendant(data)})
    assert pendants == ours
    np.testing.assert_allclose(pendants.work.X_base_nail(), ours.work.X_base_nail())


def test_the_workspace_is_turned_as_a_box(tmp_path: Path) -> None:
    corners = {"workspace_lower": (-0.3, -0.8, 0.05), "workspace_upper": (1.0, 0.6, 1.2)}
    scene = _load(tmp_path, {"frame": "pendant_base", "scene": corners}).scene
    assert scene.workspace_lower == (-1.0, -0.6, 0.05)
    assert scene.workspace_upper == (0.3, 0.8, 1.2)
    with raises(ConfigError, says="because half a turn swaps the"):
        _load(tmp_path, {"frame": "pendant_base", "scene": {"workspace_lower": (-0.3, -0.8, 0.05)}})


@examples(25)
@given(
    st.tuples(*[_coordinate] * 3),
    st.tuples(*[st.floats(-1.8, 1.8)] * 3),
)
def test_an_obstacle_is_the_same_body_in_either_frame(
    tmp_path_factory: pytest.TempPathFactory, center: tuple[float, ...], rotation: tuple[float, ...]
) -> None:
    """At the pendant both vectors read half a turn about z away."""
    folder = tmp_path_factory.mktemp("frames")
    box = {"name": "fence", "size": (0.1, 2.0, 1.5)}
    here = transform(Rotation.from_rotvec(rotation), center)
    there = HALF_TURN @ here
    as_read = {"center": there[:3, 3].tolist(), "rotation": Rotation.from_matrix(there[:3, :3]).as_rotvec().tolist()}
    ours, pendants = (
        _load(folder, {"frame": frame, "scene": {"obstacles": [{**box, **place}]}}).scene.obstacles[0]
        for frame, place in (("base_link", {"center": center, "rotation": rotation}), ("pendant_base", as_read))
    )
    np.testing.assert_allclose(ours.X_base_box, here, atol=1e-9)
    np.testing.assert_allclose(pendants.X_base_box, here, atol=1e-9)


@pytest.mark.parametrize(("section", "name"), [*POINTS, *((BOX[0], corner) for corner in BOX[1:])])
def test_a_position_without_a_frame_is_refused(tmp_path: Path, section: str, name: str) -> None:
    value = getattr(getattr(sim_station(), section), name) or (0.75, 0.10)
    with raises(ConfigError, says="pendant_base` if they were read from") as refused:
        _load(tmp_path, {section: {name: value}})
    assert f"{section}.{name}" in str(refused.value)


def test_no_frame_is_needed_without_positions(tmp_path: Path) -> None:
    assert _load(tmp_path, {"work": {"nail_length": 0.04}}).work.nail_length == 0.04
    assert _load(tmp_path, {"frame": "pendant_base"}) == sim_station()


def test_every_field_in_base_is_converted() -> None:
    """A new field whose description says that it is in `base` belongs into the list."""
    known = {*POINTS, POSE, *((BOX[0], corner) for corner in BOX[1:])}
    assert {name for name, text in field_docs(Obstacle).items() if "`base`" in text} == {"center", "rotation"}
    assert OBSTACLES == ("scene", "obstacles")
    in_base = {
        (section, name_in_file(field))
        for section, kind in SECTIONS.items()
        for field in dataclasses.fields(kind)
        if "`base`" in field_docs(kind)[field.name]
    }
    assert in_base == known
    np.testing.assert_array_equal(HALF_TURN @ HALF_TURN, np.eye(4))


HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"
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
    with raises(ConfigError) as refused:
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


@pytest.mark.parametrize("row", yaml.safe_load((HERE / "refused_station_files.yaml").read_text()), ids=str)
def test_a_typing_error_is_named(row: dict[str, Any], tmp_path: Path) -> None:
    path, file = tmp_path / "lab.yaml", row["file"]
    if isinstance(file, dict):
        file = {"frame": "base_link", **file}
        file = yaml.safe_dump({name: section for name, section in file.items() if section is not None})
    path.write_text(file)
    with raises(ConfigError, says=row["says"]) as refused:
        load_station(path)
    assert "Value error" not in str(refused.value)
