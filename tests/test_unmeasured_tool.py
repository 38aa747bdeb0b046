"""A tool of which nobody has measured everything, in a station file, in the interview and in a rehearsal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.errors import raises
from toolee_robot.cli.app import run
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.planning.views import plan_handover
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import ConfigError
from toolee_robot.station import ToolData, load_lab_station, sim_station, with_setup
from toolee_robot.stations.lab import check_purpose
from toolee_robot.stations.rehearsal import job_cell
from toolee_robot.stations.template import NONE, nullable, open_questions, parse, put
from toolee_robot.tasks.hammering.grasp import UNKNOWN_FACE_OFF, UNKNOWN_MASS, measured_grasp

LAB = Path(__file__).parents[1] / "examples" / "lab.yaml"
NOTHING = {"name": "old hammer"} | {field.name: None for field in fields(ToolData) if field.name != "name"}


def _lab(folder: Path, tool: Mapping[str, object]) -> Path:
    path = folder / "lab.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(LAB.read_text()) | {"tool": dict(tool)}))
    return path


def test_what_is_not_measured_is_null_and_a_job_may_be_done(tmp_path: Path) -> None:
    config = load_lab_station(_lab(tmp_path, NOTHING))
    check_purpose(config)
    assert config.tool is not None
    grasp = measured_grasp(config.tool, config)
    assert grasp.to_weigh
    assert (grasp.mass, grasp.ee_off) == (UNKNOWN_MASS, UNKNOWN_FACE_OFF)
    assert config.tool.weight_in_words == "weighed by the arm"


def test_a_face_that_was_measured_is_used_with_a_mass_that_was_not(tmp_path: Path) -> None:
    said = yaml.safe_load(LAB.read_text())["tool"]
    config = load_lab_station(_lab(tmp_path, said | {"mass": None, "center_of_mass": None}))
    whole = load_lab_station(LAB)
    assert config.tool is not None
    assert whole.tool is not None
    grasp, known = measured_grasp(config.tool, config), measured_grasp(whole.tool, whole)
    assert grasp.to_weigh
    assert not known.to_weigh
    assert grasp.ee_off == known.ee_off == 0.0
    np.testing.assert_array_equal(grasp.X_hand_ee, known.X_hand_ee)


@pytest.mark.parametrize(("one", "other"), [("mass", "center_of_mass"), ("face", "face_normal")])
def test_half_of_what_belongs_together_is_refused(tmp_path: Path, one: str, other: str) -> None:
    said = yaml.safe_load(LAB.read_text())["tool"]
    with raises(ConfigError, code="config.invalid") as refused:
        load_lab_station(_lab(tmp_path, said | {one: None}))
    assert f"{one} and {other} belong together" in str(refused.value)


def test_a_field_that_is_left_out_is_missing_and_not_null(tmp_path: Path) -> None:
    with raises(ConfigError, code="config.invalid") as refused:
        load_lab_station(_lab(tmp_path, {"name": "old hammer"}))
    assert "tool.mass: is missing" in str(refused.value)


def test_the_interview_takes_none_for_all_but_the_name(tmp_path: Path) -> None:
    data = yaml.safe_load(LAB.read_text())
    del data["tool"]
    asked = {question.path[-1]: question for question in open_questions(data) if question.path[0] == "tool"}
    assert set(asked) == set(NOTHING)
    for name, question in asked.items():
        assert nullable(question) == (name != "name")
        put(data, question.name, parse(question, "old hammer" if name == "name" else NONE))
    assert data["tool"] == NOTHING
    assert not [question for question in open_questions(data) if question.path[0] == "tool"]
    assert load_lab_station(_lab(tmp_path, data["tool"])).tool == ToolData(**NOTHING)  # type: ignore[arg-type]


def test_a_setup_may_name_such_a_tool(tmp_path: Path) -> None:
    path = tmp_path / "setup.yaml"
    path.write_text(yaml.safe_dump({"tool": NOTHING}))
    made = with_setup(load_lab_station(LAB), path)
    assert made.tool == ToolData(**NOTHING)  # type: ignore[arg-type]


def test_a_rehearsal_leaves_untold_what_the_file_does(tmp_path: Path) -> None:
    path = _lab(tmp_path, yaml.safe_load(LAB.read_text())["tool"] | {"mass": None, "center_of_mass": None})
    told = job_cell(load_lab_station(path), path, 3).measured.tool
    whole = job_cell(load_lab_station(LAB), LAB, 3).measured.tool
    assert told is not None
    assert whole is not None
    assert (told.mass, told.center_of_mass) == (None, None)
    assert told == replace(whole, mass=None, center_of_mass=None)
    assert sim_station().tool is None


def test_the_handover_leaves_room_for_a_tool_of_which_nothing_is_known() -> None:
    """10 cm lower than usual the forearm stands where such a tool may be, were nothing allowed for it."""
    usual = sim_station()
    x, y, z = usual.scene.handover_position
    config = replace(usual, scene=replace(usual.scene, handover_position=(x, y, z - 0.1)))
    robot = RobotModel.of_station(config)
    q_open, q_closed = robot.description.hand_open, robot.description.hand_closed
    grasp = measured_grasp(ToolData("old hammer", None, None, None, None, None), config)
    empty = CollisionWorld(robot, config, q_open)
    held = CollisionWorld(robot, config, q_closed, grasp.X_hand_ee, tool_off=UNKNOWN_FACE_OFF)
    home = np.array(config.scene.home)
    way = plan_handover(robot, config, empty, home, q_open, tool_off=UNKNOWN_FACE_OFF)
    assert held.closest(way.q[-1], 0.1).distance > 0.0


@pytest.mark.sim
@pytest.mark.parametrize("variant", ["normal_only", "position_only", "mask_centroid"])
def test_what_believes_where_the_face_nominally_is_is_refused(
    variant: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--config", str(LAB.with_name("unknown_hammer.yaml")), "--variant", variant, "--out", str(tmp_path)]
    assert run(["sim", "hammer", *options]) == 2
    assert "tool.face_normal" in " ".join(capsys.readouterr().err.split())
