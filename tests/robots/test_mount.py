"""A tool mount in the place of a hand: its data, its kinematics and mass, and the hinge that yields."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pybullet as pb
import pytest

from tests.errors import raises
from toolee_robot.control import CollisionWorld, RobotModel, plan_strike
from toolee_robot.control.contact import yield_length
from toolee_robot.end_effectors import Category
from toolee_robot.errors import ConfigError, LimitError
from toolee_robot.frames import Array
from toolee_robot.robots import SHADOW_HAND, hand_model
from toolee_robot.sim_backend.options import InHandOffset, SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import StationConfig, load_station, sim_station
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tools import Family, kinds_of, make_tool
from toolee_robot.types import ToolMount

EXAMPLE = Path(__file__).parents[2] / "examples" / "mount.yaml"
REST = np.zeros(1)


@pytest.fixture(scope="module")
def config() -> StationConfig:
    return load_station(EXAMPLE)


@pytest.fixture(scope="module")
def mount(config: StationConfig) -> ToolMount:
    assert config.hand.mount is not None
    return config.hand.mount


@pytest.fixture(scope="module")
def robot(config: StationConfig) -> RobotModel:
    return RobotModel.of_station(config)


def _load(folder: Path, text: str) -> StationConfig:
    path = folder / "lab.yaml"
    path.write_text(text)
    return load_station(path)


def test_a_mount_has_no_defaults(tmp_path: Path) -> None:
    names = [field.name for field in fields(ToolMount)]
    with pytest.raises(ConfigError) as refused:
        _load(tmp_path, "hand: {model: mount}")
    assert "hand.yield_torque and every field of hand.mount" in str(refused.value)
    with pytest.raises(ConfigError) as refused:
        _load(tmp_path, "hand: {model: mount, yield_torque: 3, mount: {position: [0, 0, 0.1]}}")
    for name in names[1:]:
        assert f"hand.mount.{name}" in str(refused.value)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"mass": -1.0}, "mass"),
        ({"clamp_mass": 2.0}, "clamp_mass"),
        ({"working_side": (1.0, 0.0, 0.3)}, "right angle"),
        ({"hinge_axis": (0.0, 0.0, 1.0)}, "hinge_axis"),
        ({"handle": (0.0, 0.0, 0.0)}, "handle"),
    ],
)
def test_a_mount_that_cannot_be_is_refused(mount: ToolMount, change: dict[str, object], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        replace(mount, **change)  # type: ignore[arg-type]


def test_a_mount_belongs_to_the_model_mount(mount: ToolMount) -> None:
    with pytest.raises(ValueError, match="mount"):
        replace(sim_station().hand, mount=mount)


def test_the_hand_is_where_the_station_file_has_it(robot: RobotModel, mount: ToolMount) -> None:
    X = robot.X_flange_hand(REST)
    np.testing.assert_allclose(X[:3, 3], mount.position, atol=1e-9)
    np.testing.assert_allclose(X[:3, 0], mount.handle, atol=1e-9)
    np.testing.assert_allclose(X[:3, 2], mount.working_side, atol=1e-9)
    tool = make_tool(kinds_of(Family.HAMMERS)[0], 0)
    grasp = robot.description.hand.grasp.X_hand_tool(0.015) @ tool.ee(Category.HAMMER_HEAD).X_tool_ee
    assert grasp[:3, 2] @ [0, 0, 1] > 0.95, "the face looks to the working side"
    assert grasp[0, 3] > 0.1, "the head is at the handle's far end"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_strike_turns_the_clamp_off_its_stop(config: StationConfig, mount: ToolMount, sign: float) -> None:
    x, y, z = mount.hinge_axis
    axis = (sign * x, sign * y, sign * z)
    own = replace(config, hand=replace(config.hand, mount=replace(mount, hinge_axis=axis)))
    robot = RobotModel.of_station(own)
    p_hand_face = np.array([0.2, 0.0, 0.1, 1.0])
    at_rest, yielded = (robot.X_flange_hand(np.array([q])) @ p_hand_face for q in (0.0, 0.1))
    assert (yielded - at_rest)[:3] @ mount.working_side < -0.01


def test_the_arm_carries_the_mount_as_weighed(robot: RobotModel, mount: ToolMount) -> None:
    payload = robot.description.hand_payload(REST)
    assert payload.mass == pytest.approx(mount.mass), "as weighed, plates included"
    np.testing.assert_allclose(payload.center_of_mass, mount.center_of_mass, atol=1e-9)


def test_the_mount_is_in_the_collision_model(robot: RobotModel, config: StationConfig, mount: ToolMount) -> None:
    world = CollisionWorld(robot, config, REST)
    (body,) = world.carried
    assert body.name == "mount"
    assert np.ptp(body.points, axis=0) == pytest.approx(np.sort(mount.body_size)[[0, 2, 1]], abs=1e-6)


def test_the_yield_torque_is_the_station_s() -> None:
    assert hand_model(sim_station().hand).yield_torque == SHADOW_HAND.yield_torque == 3.3
    soft = replace(sim_station().hand, yield_torque=2.0)
    assert hand_model(soft).yield_torque == 2.0
    assert RobotModel.of_station(replace(sim_station(), hand=soft)).description.hand.yield_torque == 2.0


def test_a_strike_turns_back_within_what_yields(config: StationConfig, mount: ToolMount) -> None:
    """A servo that lags takes the arm to the command's deepest place; what yields must cover that way."""
    tool = make_tool(kinds_of(Family.HAMMERS)[0], 3)

    def speed(travel: float) -> tuple[float, float, float]:
        own = replace(config, hand=replace(config.hand, mount=replace(mount, travel=travel)))
        robot, grasp = RobotModel.of_station(own), nominal_grasp(tool, own)
        X_hand_ee, home = grasp.X_hand_ee, np.array(own.scene.home)
        world = CollisionWorld(robot, own, REST, X_hand_ee)
        state = home, REST, X_hand_ee, own.work.X_base_nail()
        plan = plan_strike(robot, own, world, *state, tool=grasp.swung)
        return plan.speed, plan.brake_length, yield_length(robot, REST, robot.X_flange_hand(REST) @ X_hand_ee)

    fast, deepest, reach = speed(0.8)
    assert deepest <= config.strike.deepest < reach
    slower, deepest, reach = speed(0.8 * 0.5 * deepest / reach)
    assert slower < 0.9 * fast
    assert deepest <= reach < config.strike.deepest
    with raises(LimitError, "limit.swing"):
        speed(0.002)


@pytest.mark.sim
@pytest.mark.parametrize("stiffness", [0.0, 10.0])
def test_the_simulated_clamp_yields_at_its_torque(config: StationConfig, mount: ToolMount, stiffness: float) -> None:
    own = replace(config, hand=replace(config.hand, mount=replace(mount, stiffness=stiffness)))
    with SimStation.build(own, 0, SimOptions(offset=InHandOffset())) as simulation:
        world = simulation.world
        arm = np.array(mount.position) - np.array(mount.hinge_position)

        def angle(torque: float) -> float:
            """After a while under a torque about the hinge at the clamp."""

            def push(_: float) -> None:
                X = world.X_base_hand()
                vector: Array = -torque * X[:3, 1] * np.sign(-1.0)
                pb.applyExternalTorque(
                    world.robot.body, world.robot.palm, vector.tolist(), pb.WORLD_FRAME, physicsClientId=world.client
                )

            world.before_step.append(push)
            world.advance(0.4)
            world.before_step.remove(push)
            return float(world.robot.hand_state()[0][0])

        assert np.linalg.norm(arm) < 0.1
        yields = config.hand.yield_torque
        assert yields is not None
        assert abs(angle(0.8 * yields)) < 0.01
        beyond = angle(yields + 3.0)
        if stiffness:
            assert beyond == pytest.approx(3.0 / stiffness, rel=0.2)
        else:
            assert beyond > 0.9 * mount.travel
