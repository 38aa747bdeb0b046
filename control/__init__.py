"""Robot model, inverse kinematics, in-hand correction, collision check, strike planning, supervisor.

    robot = RobotModel.load()
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    plan = plan_strike(robot, config, world, q_arm, q_hand, X_hand_ee, X_base_nail, tool=hammer)
    arm = Supervisor(station.arm, station.person, robot, config, lambda: world)  # checks every motion
    arm.execute(plan.approach); arm.swing(plan.strike, ContactGuard(...), plan.expected_contact)

Import it as `toolee_robot.control`.
"""

if __name__ != "toolee_robot.control":
    raise ImportError("import toolee_robot.control: the short name would make a second copy of every module")

from toolee_robot.control.collision import Clearance, CollisionWorld
from toolee_robot.control.contact import ContactVerdict, ExpectedContact, Meeting, merge, protrusion, slip
from toolee_robot.control.limits import Mode, check_trajectory, slowed_to
from toolee_robot.control.planning.straight import plan_over_nail, plan_straight
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.planning.views import plan_handover, plan_views
from toolee_robot.control.records import StrikePlan, View, ViewPlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.supervisor import Supervisor

__all__ = [
    "Clearance",
    "CollisionWorld",
    "ContactVerdict",
    "ExpectedContact",
    "Meeting",
    "Mode",
    "RobotModel",
    "StrikePlan",
    "Supervisor",
    "View",
    "ViewPlan",
    "check_trajectory",
    "merge",
    "plan_handover",
    "plan_over_nail",
    "plan_straight",
    "plan_strike",
    "plan_transfer",
    "plan_views",
    "protrusion",
    "slip",
    "slowed_to",
]
