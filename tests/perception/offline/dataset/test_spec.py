"""Sensor and kinds of tools in a data set's specification."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.perception.offline.dataset.catalogue import GENERATED, generated_tools
from toolee_robot.perception.offline.dataset.spec import DESCRIPTION, DatasetSpec, generated_catalogue_of
from toolee_robot.sensor_kinds import KINDS, SensorKind


@pytest.mark.parametrize("sensor", KINDS)
def test_a_specification_is_read_as_it_was_written(sensor: SensorKind, tmp_path: Path) -> None:
    spec = DatasetSpec("hard", 10, 3, sensor=sensor)
    (tmp_path / DESCRIPTION).write_text(json.dumps(spec.to_json()))
    assert DatasetSpec.read(tmp_path) == spec


def test_a_data_set_from_before_there_were_sensors_is_the_same_one() -> None:
    assert "sensor" not in DatasetSpec("hard", 10, 3).to_json()


def test_a_data_set_from_before_it_said_from_how_many_kinds_was_drawn_from_thirteen(tmp_path: Path) -> None:
    old = DatasetSpec("hard", 10, 3, kinds=13)
    assert "kinds" not in old.to_json()
    for spec in (old, DatasetSpec("hard", 10, 3)):
        (tmp_path / DESCRIPTION).write_text(json.dumps(spec.to_json()))
        assert DatasetSpec.read(tmp_path) == spec
        assert len(spec.catalogue(tmp_path).numbers("train")) == 120 * spec.kinds
    with raises(UserError, code="user.kinds"):
        DatasetSpec("hard", 10, kinds=12)


def test_what_is_rendered_beside_a_data_set_is_of_its_kinds(tmp_path: Path) -> None:
    assert generated_catalogue_of(tmp_path) is GENERATED
    for kinds in (13, 17):
        (tmp_path / DESCRIPTION).write_text(json.dumps(DatasetSpec("hard", 10, 3, kinds=kinds).to_json()))
        for folder in (tmp_path, tmp_path / "test"):
            folder.mkdir(exist_ok=True)
            assert generated_catalogue_of(folder) is generated_tools(kinds)


def test_a_data_set_of_a_newer_version_is_refused_as_such(tmp_path: Path) -> None:
    (tmp_path / DESCRIPTION).write_text(json.dumps({**DatasetSpec("hard", 10, 3).to_json(), "kinds": 25}))
    with raises(UserError, code="user.newer_data_set"):
        DatasetSpec.read(tmp_path)


def test_an_unknown_sensor_and_one_for_a_camera_without_noise_are_refused() -> None:
    with pytest.raises(UserError, match="choose one of time-of-flight"):
        DatasetSpec("hard", 10, sensor="radar")  # type: ignore[arg-type]
    with pytest.raises(UserError, match="choose hard"):
        DatasetSpec("paper", 10, sensor="active-stereo")
