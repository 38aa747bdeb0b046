"""Another hand than the Shadow Hand goes through everything that knows hands: model, planning, payload, grip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.robots.three_finger import THREE_FINGER_HAND
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover
from toolee_robot.errors import AssetError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.robots import HANDS, load_robot
from toolee_robot.sim_backend import SimStation
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


def test_pinocchio_and_numpy_agree_on_its_kinematics(robot: RobotModel) -> None:
    q_arm = np.array([0.3, -1.2, 1.4, -0.4, 0.7, 0.2])
    poses = robot.description.link_poses(q_arm, _bent())
    np.testing.assert_allclose(robot.fk(q_arm, _bent())[1], poses[HAND.frame], atol=1e-9)
    tip = inverse(poses[HAND.frame]) @ poses["b_upper"]
    np.testing.assert_allclose(HAND.link_poses(_bent())["b_upper"], tip, atol=1e-9)
    assert tip[1, 3] < -0.02, "bent fingers are before the palm"


def test_planning_sees_its_fingers(robot: RobotModel, handover: Trajectory) -> None:
    world = CollisionWorld(robot, CONFIG, HAND.posture("open"))
    assert {body.name for body in world.bodies if body.group == "hand"} == {"opposer", "a", "b", "c", "palm"}
    assert world.closest(handover.q).distance > 0.005
    into_the_table = transform(np.diag([1.0, -1.0, -1.0]), [0.6, 0.0, 0.1])
    q = robot.ik.branches(into_the_table @ inverse(robot.X_flange_hand(HAND.posture("open")))[None])
    q = q[np.all(np.isfinite(q), axis=-1)]
    assert "table" in world.closest(q[0]).pair


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
