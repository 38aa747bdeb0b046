"""Another hand than the Shadow Hand goes through everything that knows hands: model, planning, payload, grip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.robots.three_finger import THREE_FINGER_HAND
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover
from toolee_robot.errors import AssetError, ConfigError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.robots import HANDS, SHADOW_HAND, load_robot, wrap_fingers
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import HandConfig, sim_station
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.types import Trajectory

pytestmark = pytest.mark.sim

HAND = THREE_FINGER_HAND
CONFIG = replace(sim_station(), hand=HandConfig(HAND.name))


@pytest.fixture(scope="module", autouse=True)
def _known() -> Iterator[None]:
    HANDS[HAND.name] = HAND
    yield
    del HANDS[HAND.name]


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.of_station(CONFIG)


@pytest.fixture(scope="module")
def handover(robot: RobotModel) -> Trajectory:
    q_open = HAND.posture("open")
    return plan_handover(robot, CONFIG, CollisionWorld(robot, CONFIG, q_open), np.array(CONFIG.scene.home), q_open)


def _bent() -> Array:
    return HAND.posture("preshape")


def test_the_station_file_chooses_the_hand() -> None:
    assert load_robot(hand=HAND.name).hand_joints == HAND.joints
    assert load_robot().hand_joints == SHADOW_HAND.joints
    with pytest.raises(ConfigError, match="shadow_right"):
        load_robot(hand="claw")


def test_pinocchio_and_numpy_agree_on_its_kinematics(robot: RobotModel) -> None:
    q_arm = np.array([0.3, -1.2, 1.4, -0.4, 0.7, 0.2])
    poses = robot.description.link_poses(q_arm, _bent())
    np.testing.assert_allclose(robot.fk(q_arm, _bent())[1], poses[HAND.frame], atol=1e-9)
    tip = inverse(poses[HAND.frame]) @ poses["b_upper"]
    np.testing.assert_allclose(HAND.link_poses(_bent())["b_upper"], tip, atol=1e-9)
    assert tip[1, 3] < -0.02, "bent fingers are before the palm"


def test_the_arm_carries_hand_and_tool(robot: RobotModel) -> None:
    bare = robot.description.hand_payload(_bent())
    assert bare.mass == pytest.approx(0.1 + 0.6 + 0.001 + 4 * 0.08)  # plate, palm, its mark, fingers
    loaded = robot.payload(_bent(), HAND.grasp.X_hand_tool(0.014), 0.8, np.zeros(3))
    assert loaded.mass == pytest.approx(bare.mass + 0.8)
    assert loaded.center_of_mass[2] > bare.center_of_mass[2]


def test_planning_sees_its_fingers(robot: RobotModel, handover: Trajectory) -> None:
    world = CollisionWorld(robot, CONFIG, HAND.posture("open"))
    assert {body.name for body in world.bodies if body.group == "hand"} == {"opposer", "a", "b", "c", "palm"}
    assert world.closest(handover.q).distance > 0.005
    into_the_table = transform(np.diag([1.0, -1.0, -1.0]), [0.6, 0.0, 0.1])
    q = robot.ik.branches(into_the_table @ inverse(robot.X_flange_hand(HAND.posture("open")))[None])
    q = q[np.all(np.isfinite(q), axis=-1)]
    assert "table" in world.closest(q[0]).pair


def test_fingers_wrap_around_a_handle() -> None:
    X_hand_tool = HAND.grasp.X_hand_tool(0.014)
    poses = HAND.link_poses(wrap_fingers(HAND, X_hand_tool, 0.014))
    for finger in "abc":
        in_tool = inverse(X_hand_tool) @ poses[f"{finger}_upper"] @ [0.0, 0.0, 0.045, 1.0]
        assert 0.014 + 0.007 < np.hypot(in_tool[0], in_tool[1]) < 0.05
        assert in_tool[1] > 0, "around the far side: the palm is at -y"


@pytest.mark.nightly
def test_it_closes_on_a_hammer_and_holds_it_by_contact(handover: Trajectory) -> None:
    with SimStation.build(CONFIG, 100, SimOptions(q_start=handover.q[-1])) as simulation:
        station, world = simulation.station, simulation.world
        assert station.hand.joint_names == HAND.joints
        assert station.person.request_handover("", 10.0)
        station.hand.close()
        state = station.hand.state()
        assert state.joints.q.shape == (len(HAND.joints),)
        assert state.holding
        assert set(state.contact_forces) == {"opposer", "a", "b", "c", "palm"}
        assert state.contact_forces["opposer"] > 1.0
        assert station.person.release("", 10.0)
        before = inverse(world.X_base_hand()) @ world.X_base_tool()
        world.advance(0.5)
        after = inverse(world.X_base_hand()) @ world.X_base_tool()
        assert station.hand.state().holding
        assert np.linalg.norm(after[:3, 3] - before[:3, 3]) < 0.002
        # The flange feels the tool's weight: the sensor knows how the hand is mounted.
        assert station.arm.state().wrench[2] == pytest.approx(-9.81 * simulation.tool.mass, abs=1.0)
        station.hand.open()
        assert not station.hand.state().holding


@pytest.mark.nightly
def test_a_whole_job_drives_the_nail_with_it() -> None:
    with SimStation.build(CONFIG, 100) as simulation:
        perception = PerfectPerception(simulation.judge)
        grasp = nominal_grasp(simulation.tool, CONFIG)
        result = HammeringTask(simulation.station, perception, CONFIG, grasp).run()
        assert result.outcome is Outcome.FLUSH, result.reason
        assert simulation.judge.verdict(result.estimates).misses == 0


def test_a_model_file_with_other_joints_is_refused(tmp_path: Path) -> None:
    text = HAND.source.read_text()
    (tmp_path / "hand.urdf").write_text(text.replace("a_bend", "first_bend"))
    with pytest.raises(AssetError, match="first_bend"):
        _ = replace(HAND, source=tmp_path / "hand.urdf").tree
    (tmp_path / "hand.urdf").write_text(text.replace('type="revolute"', 'type="prismatic"', 1))
    with pytest.raises(AssetError, match="prismatic"):
        _ = replace(HAND, source=tmp_path / "hand.urdf").tree
    (tmp_path / "hand.urdf").write_text(text.replace("gripper_base", "base_link"))
    HANDS["clash"] = replace(HAND, name="clash", source=tmp_path / "hand.urdf")
    with pytest.raises(AssetError, match="base_link"):
        load_robot(hand="clash")
    del HANDS["clash"]


def test_a_record_that_names_no_joint_of_its_own_is_refused() -> None:
    with pytest.raises(ValueError, match="rh_FFJ3"):
        replace(HAND, closing_order=(("rh_FFJ3",),))
