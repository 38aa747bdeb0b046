"""Robot model, inverse kinematics, in-hand correction, collision check, strike planning, supervisor.

    robot = RobotModel.load()
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    plan = plan_strike(robot, config, world, q_arm, q_hand, X_hand_ee, X_base_nail, tool=hammer)
    arm = Supervisor(station.arm, station.person, robot, config, lambda: world)  # checks every motion
    arm.execute(plan.approach); arm.swing(plan.strike, ContactGuard(...), plan.expected_contact)

Import it as `toolee_robot.control`. Every name is loaded on its first use: the servo process of an arm loads little.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if __name__ != "toolee_robot.control":
    raise ImportError("import toolee_robot.control: the short name would make a second copy of every module")

if TYPE_CHECKING:
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

_MODULES = {
    "Clearance": "toolee_robot.control.collision",
    "CollisionWorld": "toolee_robot.control.collision",
    "ContactVerdict": "toolee_robot.control.contact",
    "ExpectedContact": "toolee_robot.control.contact",
    "Meeting": "toolee_robot.control.contact",
    "Mode": "toolee_robot.control.limits",
    "RobotModel": "toolee_robot.control.robot_model",
    "StrikePlan": "toolee_robot.control.records",
    "Supervisor": "toolee_robot.control.supervisor",
    "View": "toolee_robot.control.records",
    "ViewPlan": "toolee_robot.control.records",
    "check_trajectory": "toolee_robot.control.limits",
    "merge": "toolee_robot.control.contact",
    "plan_handover": "toolee_robot.control.planning.views",
    "plan_over_nail": "toolee_robot.control.planning.straight",
    "plan_straight": "toolee_robot.control.planning.straight",
    "plan_strike": "toolee_robot.control.planning.strike",
    "plan_transfer": "toolee_robot.control.planning.transfer",
    "plan_views": "toolee_robot.control.planning.views",
    "protrusion": "toolee_robot.control.contact",
    "slip": "toolee_robot.control.contact",
    "slowed_to": "toolee_robot.control.limits",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
