"""Which `servoj` a controller executes."""

from __future__ import annotations

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import ServoLag
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.motion import Motion
from toolee_robot.sim_backend.ur_controller.robot.servo.exact import ServoJ
from toolee_robot.sim_backend.ur_controller.robot.servo.lagging import LaggingServoJ


def servoj(
    model: ControllerModel, servo: ServoLag | None, q_goal: Array, time: float, lookahead: float, gain: float
) -> Motion:
    """The motion of one call of `servoj`.

    Args:
        model: The robot's model.
        servo: The controller's lag; None for none.
        q_goal: Goal, (6,) [rad].
        time: Time after which it is due [s].
        lookahead: `lookahead_time` [s].
        gain: `gain`.

    Returns:
        The motion.
    """
    if servo is None:
        return ServoJ(model, q_goal, time)
    return LaggingServoJ(model, servo, q_goal, lookahead, gain)
