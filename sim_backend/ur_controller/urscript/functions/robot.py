"""The URScript functions that need a robot: every public method is a function of that name."""

from __future__ import annotations

from toolee_robot.sim_backend.ur_controller.urscript.functions.io import IoFunctions
from toolee_robot.sim_backend.ur_controller.urscript.functions.motion import MotionFunctions
from toolee_robot.sim_backend.ur_controller.urscript.functions.state import StateFunctions

E_SERIES_ONLY = frozenset(
    {
        *("end_freedrive_mode", "force_mode_set_gain_scaling", "freedrive_mode", "ft_rtde_input_enable"),
        *("get_actual_joint_positions_history", "get_freedrive_status", "get_steptime", "get_target_payload"),
        *("get_target_payload_cog", "get_target_payload_inertia", "get_target_waypoint", "set_target_payload"),
        "tool_contact",
    }
)


class RobotFunctions(MotionFunctions, StateFunctions, IoFunctions):
    """The functions of one robot.

    Args:
        machine: The robot.
    """


def function_names(e_series: bool) -> list[str]:
    """Names of the functions of a CB3 or an e-Series controller."""
    names = [name for name in dir(RobotFunctions) if not name.startswith("_")]
    return [name for name in names if e_series or name not in E_SERIES_ONLY]
