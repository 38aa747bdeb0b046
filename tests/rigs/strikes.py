"""The swing during which faults are injected: a strike in the default station, planned as in a job."""

from __future__ import annotations

import signal
import sys
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tests.rigs.joints_path import PATIENT
from tests.rigs.setting import Setting
from toolee_robot.control.arm_dynamics import ArmDynamics, bound_stop
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.end_effectors import Category
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array, inverse
from toolee_robot.sim_backend.station import draw_hammer
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.types import ArmModel, Payload, Trajectory


@dataclass(frozen=True)
class Swing:
    """A planned swing."""

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
    strike = bound_stop(plan.strike, ArmDynamics.with_payload(robot, q_hand, None), model)
    return Swing(config, robot, world, q_hand, X_hand_ee, swung, plan, strike)


def main() -> None:
    """Connect the arm, wait for the line, swing."""
    # A process that a shell started in the background inherits that Ctrl-C is ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    profile: ProfileName = "harsh" if sys.argv[3] == "harsh" else "ideal"
    setting = Setting(ArmModel(sys.argv[2]), sys.argv[1], profile)
    swing = plan_swing(setting.model)
    with UnsupervisedUrArm(UrArmConfig(setting.host, setting.servo), swing.config.arm) as arm:
        print("ready", flush=True)
        sys.stdin.readline()
        try:
            print(arm.execute(swing.plan.strike, None, PATIENT).outcome, flush=True)
        except DeviceError as error:
            print(type(error).__name__, flush=True)


if __name__ == "__main__":
    main()
