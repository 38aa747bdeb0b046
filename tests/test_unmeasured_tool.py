"""A tool of which nobody has measured everything, in a station file, in the interview and in a rehearsal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from tests.examples import examples
from toolee_robot.cli.app import run
from toolee_robot.control import RobotModel
from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.planning.views import plan_handover
from toolee_robot.devices.ur.probe import UrState
from toolee_robot.doctor.frames import check_base, check_mounting
from toolee_robot.errors import ConfigError
from toolee_robot.findings import Finding, Level
from toolee_robot.frames import HALF_TURN, Array
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote import RemoteWorld
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import StationConfig, ToolData, load_lab_station, sim_station
from toolee_robot.stations.lab import LabStation, Purpose, check_purpose
from toolee_robot.stations.rehearsal import job_cell
from toolee_robot.stations.template import NONE, nullable, open_questions, parse, put
from toolee_robot.tasks.hammering.grasp import UNKNOWN_FACE_OFF, UNKNOWN_MASS, measured_grasp
from toolee_robot.types import Payload

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


CEILING = (0.0, 0.0, -1.0)
Q = np.array(sim_station().scene.home)
_angles = st.tuples(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
_joints = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


def _up(tilt: float, turn: float) -> tuple[float, float, float]:
    """Straight up in a base that is turned about its own z and then tilted about the world's x."""
    x, y, z = (Rotation.from_euler("xz", [tilt, turn]).inv().apply([0.0, 0.0, 1.0])).tolist()
    return x, y, z


def _mounted(up: tuple[float, float, float]) -> StationConfig:
    config = sim_station()
    return replace(config, arm=replace(config.arm, up=up))


@examples(50)
@given(_angles, st.floats(0.01, 20.0))
def test_gravity_is_against_up_and_the_tilt_is_that_of_the_base(angles: tuple[float, float], length: float) -> None:
    up = _up(*angles)
    arm = replace(sim_station().arm, up=(up[0] * length, up[1] * length, up[2] * length))
    np.testing.assert_allclose(arm.gravity, -9.81 * np.array(up), atol=1e-9)
    assert np.cos(arm.tilt) == pytest.approx(np.cos(angles[0]), abs=1e-9)


@examples(25)
@given(_angles, _joints)
def test_joint_torques_at_rest_carry_the_weight_along_gravity_in_the_base(
    angles: tuple[float, float], q: Array
) -> None:
    """Against the virtual work of the weights: minus the gradient of the potential energy, by differences."""
    robot = RobotModel.of_station(_mounted(_up(*angles)))
    q_hand = robot.description.hand_closed
    dynamics = ArmDynamics(robot, q_hand, np.eye(4), Payload(0.9, np.array([0.0, 0.05, 0.1])))
    model, data = dynamics.model, dynamics.model.createData()

    def energy(q: Array) -> float:
        com = pin.centerOfMass(model, data, q)
        return float(-pin.computeTotalMass(model) * replace(sim_station().arm, up=_up(*angles)).gravity @ com)

    step = 1e-6 * np.eye(6)
    expected = [(energy(q + d) - energy(q - d)) / 2e-6 for d in step]
    zero = np.zeros((1, 6))
    np.testing.assert_allclose(dynamics.torques(q[None], zero, zero)[0], expected, atol=1e-4)
    np.testing.assert_allclose(dynamics.at_rest(q)[1], expected, atol=1e-4)


def _state(q: Array, felt: Array | None) -> UrState:
    return UrState(q, np.zeros(6), np.zeros(6), np.zeros(6), None, 7, 1, 1, 3, 1, 1.0, felt)


def _felt(q: Array, up: tuple[float, float, float]) -> Array:
    """What the tool's accelerometer reads in a base that stands so."""
    R_base_flange = (HALF_TURN @ DhParameters.of(sim_station().arm.model).fk(q))[:3, :3]
    return 9.82 * R_base_flange.T @ np.array(up)


def _finding(told: tuple[float, float, float], felt: Array | None, q: Array = Q) -> Finding:
    return check_mounting(_state(q, felt), _mounted(told))


@examples(50)
@given(_angles, _joints, st.floats(0.0, np.pi))
@example((0.0, 0.0), Q, np.pi)
def test_the_doctor_finds_a_mounting_that_is_not_the_one_told(
    angles: tuple[float, float], q: Array, off: float
) -> None:
    told = _up(*angles)
    axis = np.cross(told, [1.0, 0.0, 0.0] if abs(told[0]) < 0.9 else [0.0, 1.0, 0.0])
    x, y, z = Rotation.from_rotvec(off * axis / np.linalg.norm(axis)).apply(told).tolist()
    finding = _finding(told, _felt(q, (x, y, z)), q)
    if abs(np.degrees(off) - 5.0) > 0.01 and abs(np.degrees(off) - 175.0) > 0.01:
        upside_down = np.degrees(off) > 175.0  # the mounting, or the accelerometer's sign
        assert finding.level is (Level.OK if np.degrees(off) < 5.0 else Level.WARN if upside_down else Level.FAIL)
    assert f"{np.degrees(off):.1f}° off" in finding.message or abs((np.degrees(off) * 10) % 1 - 0.5) < 1e-3


def test_the_message_tells_the_mounting_in_both_frames_and_no_reading_is_no_proof() -> None:
    wall = (0.6, 0.8, 0.0)
    told = _finding((0.0, 0.0, 1.0), _felt(Q, wall))
    assert "(0.60, 0.80, 0.00) in base_link, (-0.60, -0.80, 0.00) in pendant_base; arm.up is 90.0° off" in told.message
    assert "Mounting" in told.remedy
    for felt in (None, np.zeros(3), np.full(3, np.nan), 2.0 * _felt(Q, wall)):
        assert _finding(wall, felt).level is Level.WARN
    moving = replace(_state(Q, _felt(Q, wall)), qd=np.full(6, 0.1))
    assert check_mounting(moving, _mounted(wall)).level is Level.WARN


def test_a_base_that_is_level_enough_is_upright() -> None:
    assert check_base(_mounted((0.0, np.sin(np.radians(0.9)), 1.0))).level is Level.OK
    assert check_base(_mounted((0.0, np.sin(np.radians(1.1)), 1.0))).level is Level.WARN
    assert "tilted by 180.0°: no job" in check_base(_mounted(CEILING)).message


@pytest.mark.parametrize("purpose", list(Purpose))
def test_a_tilted_base_is_refused_by_what_takes_z_for_up(purpose: Purpose) -> None:
    lab = load_lab_station(LAB)
    tilted = replace(lab, arm=replace(lab.arm, up=CEILING))
    with raises(ConfigError, "config.mounting_tilted") as caught:
        LabStation(tilted, print, purpose=purpose)
    assert f"tilted by 180.0°, but {purpose} needs it upright" in str(caught.value)


def test_no_simulated_world_is_built_around_a_tilted_base() -> None:
    with raises(ConfigError, "config.mounting_tilted"):
        SimStation.build(_mounted(CEILING))
    with raises(ConfigError, "config.mounting_tilted"):
        RemoteWorld(_mounted(CEILING), 0, SimOptions(), "127.0.0.44", HostClock())


@pytest.mark.parametrize(
    "command",
    [
        ["rehearse", "hammer", "lab.yaml"],
        ["sim", "hammer", "--station", "lab.yaml"],
        ["station", "check", "lab.yaml"],
        ["calibrate", "camera", "--station", "lab.yaml", "--rehearse"],
        ["calibrate", "nail", "--station", "lab.yaml", "--rehearse"],
    ],
    ids=" ".join,
)
def test_the_commands_say_that_the_base_is_tilted(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said: dict[str, Any] = yaml.safe_load(LAB.read_text())
    said["arm"]["up"] = list(CEILING)
    (tmp_path / "lab.yaml").write_text(yaml.safe_dump(said))
    monkeypatch.chdir(tmp_path)
    assert run(command) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "arm.up [0.0, 0.0, -1.0]: the base is tilted by 180.0°" in told
