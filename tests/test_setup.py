"""What is set up for one job takes the place of what the station file says, and of nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from toolee_robot.errors import ConfigError
from toolee_robot.frames import inverse
from toolee_robot.station import ToolData, load_lab_station, load_station, sim_station, with_setup
from toolee_robot.station.job import check_enclosed

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


LONG = TOOL.replace("0.27]", "0.38]").replace("[0.05,", "[0.075,")


def test_another_tools_shape_is_given_with_it(tmp_path: Path) -> None:
    """A sledge hammer is longer than the station's claw hammer, and its handle farther behind its face."""
    lab = load_lab_station(EXAMPLES / "lab.yaml")
    with raises(ConfigError, code="config.tool_envelope") as refused:
        with_setup(lab, _written(tmp_path, LONG))
    assert "380 mm from the face" in str(refused.value)
    made = with_setup(lab, _written(tmp_path, LONG + "tool_envelope: {handle_depth: 0.075, handle_length: 0.5}"))
    assert (made.tool_envelope.handle_depth, made.tool_envelope.handle_length) == (0.075, 0.5)
    no_face = LONG.replace("[0.075, 0.0, 0.38]", "null").replace("[1.0, 0.0, 0.0]", "null")
    assert with_setup(lab, _written(tmp_path, no_face)).tool_envelope == lab.tool_envelope


@given(
    depth=st.floats(0.0, 0.1), side=st.floats(-0.03, 0.03), length=st.floats(0.15, 0.5), tilt=st.floats(-0.3, 0.3),
    grip=st.floats(0.005, 0.025),
)  # fmt: skip
def test_what_passes_lies_within_the_cylinder(
    depth: float, side: float, length: float, tilt: float, grip: float
) -> None:
    """By points around the handle where the hand holds it, in the frame of `ToolEnvelope`."""
    tool = ToolData("hammer", grip, (depth, side, length), (np.cos(tilt), 0.0, np.sin(tilt)), 0.6, (0.0, 0.0, 0.1))
    config = replace(sim_station(), tool=tool)
    X_face_tool = inverse(tool.X_tool_face)  # type: ignore[arg-type]
    turns = np.linspace(0.0, 2.0 * np.pi, 60)
    around = np.stack([grip * np.cos(turns), grip * np.sin(turns), 0.0 * turns], axis=-1)
    x, y, z = (around @ X_face_tool[:3, :3].T + X_face_tool[:3, 3]).T
    envelope = config.tool_envelope
    inside = np.hypot(y, z + envelope.handle_depth).max() <= envelope.handle_radius + 1e-9
    try:
        check_enclosed(config, Path("lab.yaml"))
    except ConfigError:
        return
    assert inside
    assert x.mean() <= envelope.handle_length


@pytest.mark.parametrize(
    ("text", "code", "what"),
    [
        ("tool: {name: ball peen, mass: 0.6}", "config.invalid", "grip_radius"),
        ("work: {nail_xy: [0.1, 0.2]}", "config.invalid", "nail_xy"),
        ("work: {nail_protrusion: 0.05}", "config.invalid", "nail_length"),
        ("work: {nail_diameter: 3.1, nail_length: 65}", "config.invalid", "nail_length"),
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
    assert with_setup(sim_station(), _written(tmp_path, "work: {nail_diameter: 0.003}")).work.nail_diameter == 0.003
