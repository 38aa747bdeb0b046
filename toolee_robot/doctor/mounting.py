"""Check of the arm's mounting: what the station file says of it, and what the tool's accelerometer feels at rest."""

from __future__ import annotations

import numpy as np

from toolee_robot.devices.ur.report import UrState
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.frames import HALF_TURN, Array, BaseFrame
from toolee_robot.robots.dh import DhParameters
from toolee_robot.station import UPRIGHT_WITHIN, StationConfig
from toolee_robot.station.robot import GRAVITY

NAME = "mounting"
TOLERANCE = np.radians(5.0)
"""Largest angle between the mounting told and the one felt [rad]. UR tells no accuracy of the accelerometer; a wrong
mounting is usually off by 90 or 180 degrees."""
SIZE_TOLERANCE = 2.0
"""Largest deviation of the felt acceleration from gravity's of an arm at rest [m/s^2]."""
AT_REST = 0.02
"""Speed of a joint above which the arm is not at rest [rad/s]."""


def check_base(config: StationConfig) -> Finding:
    """Tell how the base stands by the station file, and what a tilted one is good for.

    Args:
        config: Configuration of the station.

    Returns:
        OK for an upright base; WARN for a tilted one, which only slow motions may move.
    """
    arm = config.arm
    message = f"arm.up {_text(np.array(arm.up))}: "
    if arm.tilt <= UPRIGHT_WITHIN:
        return ok("base", f"{message}upright to {np.degrees(arm.tilt):.1f}°")
    message += f"tilted by {np.degrees(arm.tilt):.1f}°: no job and no calibration; `toolee arm` moves it slowly"
    return warn("base", message, f"a job needs a base that is upright to {np.degrees(UPRIGHT_WITHIN):.0f}°")


def check_mounting(state: UrState, config: StationConfig) -> Finding:
    """Compare the mounting that the station file tells with gravity as the tool's accelerometer feels it.

    The accelerometer has the axes of the tool, here the flange's; an axis that points upwards reads positive (URScript
    manual, get_tool_accelerometer_reading).

    Args:
        state: The robot's state.
        config: Configuration of the station.

    Returns:
        OK; FAIL for another mounting; WARN where nothing can be concluded.
    """
    felt = state.accelerometer
    look = "look whether the base stands as arm.up of the station file and PolyScope's Mounting page say"
    if felt is None:
        return warn(NAME, "this PolyScope does not report the tool's accelerometer", look)
    size = float(np.linalg.norm(felt))
    if not abs(size - GRAVITY) <= SIZE_TOLERANCE or np.max(np.abs(state.qd)) > AT_REST:
        return warn(NAME, f"the tool's accelerometer reads {size:.1f} m/s²: no arm at rest, or no such sensor", look)
    R_pendant_flange = DhParameters.of(config.arm.model, config.arm.calibration).fk(state.q)[:3, :3]
    up_pendant = R_pendant_flange @ felt / size
    up_base = HALF_TURN[:3, :3] @ up_pendant
    told = np.array(config.arm.up) / np.linalg.norm(config.arm.up)
    off = float(np.arctan2(np.linalg.norm(np.cross(told, up_base)), told @ up_base))
    message = (
        f"the tool's accelerometer feels straight up along {_text(up_base)} in {BaseFrame.BASE_LINK}, "
        f"{_text(up_pendant)} in {BaseFrame.PENDANT_BASE}; arm.up is {np.degrees(off):.1f}° off"
    )
    if off <= TOLERANCE:
        return ok(NAME, message)
    if off >= np.pi - TOLERANCE:
        # That what points upwards reads positive is one sentence of a manual, and was never seen on a robot.
        remedy = "hold a spirit level to the base: if it stands as arm.up says, this accelerometer has the other sign"
        return warn(NAME, f"{message}: upside down", f"{remedy}; please report it, and leave arm.up as it is")
    remedy = "correct arm.up; and set PolyScope's Mounting page right before the brakes are released again"
    return fail(NAME, message, remedy)


def _text(direction: Array) -> str:
    x, y, z = direction / np.linalg.norm(direction) + 0.0
    return f"({x:.2f}, {y:.2f}, {z:.2f})".replace("-0.00", "0.00")
