"""What is set up for one job takes the place of what the station file says, and of nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.errors import raises
from toolee_robot.config import StationConfig, load_lab_station, load_station, with_setup
from toolee_robot.errors import ConfigError

EXAMPLES = Path(__file__).parents[1] / "examples"
TOOL = """
tool: {name: ball peen, grip_radius: 0.014, face: [0.05, 0.0, 0.27], face_normal: [1.0, 0.0, 0.0], mass: 0.6,
  center_of_mass: [0.0, 0.0, 0.16]}
"""


def _written(folder: Path, text: str) -> Path:
    path = folder / "setup.yaml"
    path.write_text(text)
    return path


def test_the_rest_stays_the_station_files(tmp_path: Path) -> None:
    lab = load_lab_station(EXAMPLES / "lab.yaml")
    made = with_setup(lab, _written(tmp_path, TOOL))
    assert made.tool is not None
    assert (made.tool.name, made.tool.mass) == ("ball peen", 0.6)
    assert replace(made, tool=lab.tool) == lab
    made = with_setup(lab, _written(tmp_path, "work: {wood_specific_gravity: 0.68, nail_length: 0.04}"))
    assert made == replace(lab, work=replace(lab.work, wood_specific_gravity=0.68, nail_length=0.04))
    assert with_setup(lab, _written(tmp_path, "")) == lab


@pytest.mark.parametrize(
    ("text", "code", "what"),
    [
        ("tool: {name: ball peen, mass: 0.6}", "config.invalid", "grip_radius"),
        ("work: {nail_xy: [0.1, 0.2]}", "config.invalid", "nail_xy"),
        ("work: {nail_protrusion: 0.05}", "config.invalid", "nail_length"),
        ("work: {nail_diameter: 3.1, nail_length: 65}", "config.unit", "nail_length"),
        ("camera: {fx: 3}", "config.invalid", "camera"),
    ],
)
def test_what_it_cannot_say_is_refused(tmp_path: Path, text: str, code: str, what: str) -> None:
    with raises(ConfigError, code=code) as refused:
        with_setup(load_lab_station(EXAMPLES / "lab.yaml"), _written(tmp_path, text))
    assert what in str(refused.value)


def test_of_several_nails_it_gives_the_wood_alone(tmp_path: Path) -> None:
    several = load_station(EXAMPLES / "nails.yaml")
    made = with_setup(several, _written(tmp_path, "work: {wood_specific_gravity: 0.5}"))
    assert made.work.wood_specific_gravity == 0.5
    assert made.work.nails == several.work.nails
    with raises(ConfigError, code="config.invalid"):
        with_setup(several, _written(tmp_path, "work: {nail_diameter: 0.003}"))
    assert with_setup(StationConfig(), _written(tmp_path, "work: {nail_diameter: 0.003}")).work.nail_diameter == 0.003
