"""The swing during which faults are injected: a strike in the default station, planned as in a job."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from toolee_robot.control.arm_dynamics import bound_stop
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse
from toolee_robot.sim_backend.station import draw_hammer
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.types import ArmModel, Payload, Trajectory


@dataclass(frozen=True)
class Swing:
    """A planned swing.

    Attributes:
        config: Configuration of the station.
        robot: Kinematic model of arm and hand.
        world: Collision model with the held hammer.
        q_hand: Joint positions of the hand, (n,) [rad].
        X_hand_ee: Pose of the end effector in the hand, (4, 4).
        tool: Mass of the tool [kg] and its centre of mass in the end effector's frame [m].
        plan: Plan of the strike.
        strike: The strike with stops that keep the joints' torques, as a supervisor that was told no payload sends it.
    """

    config: StationConfig
    robot: RobotModel
    world: CollisionWorld
    q_hand: Array
    X_hand_ee: Array
    tool: Payload
    plan: StrikePlan
    strike: Trajectory


@lru_cache(maxsize=2)
def plan_swing(model: ArmModel) -> Swing:
    """Plan the swing of an arm of this model with a held-out hammer in the nominal grasp."""
    config = replace(sim_station(), arm=replace(sim_station().arm, model=model))
    robot = RobotModel.load(model)
    tool = draw_hammer(np.random.default_rng([0, 10]))
    X_hand_tool = robot.description.hand.grasp.X_hand_tool(tool.handle.grip_radius)
    X_tool_ee = tool.ee(Category.HAMMER_HEAD).X_tool_ee
    X_hand_ee = X_hand_tool @ X_tool_ee
    swung = Payload(tool.mass, tool.center_of_mass).seen_from(inverse(X_tool_ee))
    q_hand = robot.description.hand_closed
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    home = np.asarray(config.scene.home)
    plan = plan_strike(robot, config, world, home, q_hand, X_hand_ee, config.work.X_base_nail(), tool=swung)
    strike = bound_stop(plan.strike, robot, model, q_hand, None)
    return Swing(config, robot, world, q_hand, X_hand_ee, swung, plan, strike)
