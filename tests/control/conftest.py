"""One robot, one station, one nominal hammer for the control tests."""

from __future__ import annotations

import numpy as np
import pytest

from tests.control.desk import TOOL, Desk
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.station import StationConfig, sim_station


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    return RobotModel.load()


@pytest.fixture(scope="session")
def config() -> StationConfig:
    return sim_station()


@pytest.fixture(scope="session")
def home(config: StationConfig) -> Array:
    return np.array(config.scene.home)


@pytest.fixture(scope="session")
def q_hand(robot: RobotModel) -> Array:
    """Fingers around a handle."""
    return robot.description.hand_closed


@pytest.fixture(scope="session")
def X_tool_ee() -> Array:
    return frame_from_axes(z=np.array([1.0, 0, 0]), x=np.array([0, 0, -1.0]), p=[0.05, 0.0, 0.20])


@pytest.fixture(scope="session")
def X_hand_ee(X_tool_ee: Array) -> Array:
    return SHADOW_HAND.grasp.X_hand_tool(0.016) @ X_tool_ee


@pytest.fixture
def world(robot: RobotModel, config: StationConfig, q_hand: Array, X_hand_ee: Array) -> CollisionWorld:
    return CollisionWorld(robot, config, q_hand, X_hand_ee)


@pytest.fixture
def desk(robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array) -> Desk:
    return Desk(robot, config, world, home)


@pytest.fixture(scope="session")
def plan(robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_hand_ee: Array) -> StrikePlan:
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    return plan_strike(robot, config, world, home, q_hand, X_hand_ee, config.work.X_base_nail(), tool=TOOL)
