"""Checks of the frames and of the arm's mounting: what person, station file and robot say of where the base is.

The controller's base and `base_link` differ by half a turn about z. A station that was entered in the wrong one of them
is consistent in itself, on the far side of the robot.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from toolee_robot.devices.ur.probe import UrState
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.frames import HALF_TURN, Array, BaseFrame
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.station import UPRIGHT_WITHIN, StationConfig
from toolee_robot.station.robot import GRAVITY
from toolee_robot.types import ArmModel

TOLERANCE = 2e-3
"""Deviation of a reading at the pendant that counts as the same point [m]: it shows tenths of a millimetre."""
JOGGED_POINT = "jogged point"
"""Name of the finding of that reading."""
ON_AXIS = 0.02
"""Distance from the base's axis within which half a turn would not be noticed [m]."""


def check_frames(state: UrState, config: StationConfig, jogged_point: Array | None) -> Iterator[Finding]:
    """Tell the TCP in both frames, and compare a reading at the pendant with it.

    Args:
        state: The robot's state.
        config: Configuration of the station.
        jogged_point: The TCP that the pendant shows for the present posture, feature Base, (3,) [m]; None if nobody
            has read it.

    Yields:
        The findings "TCP place" and "jogged point".
    """
    tcp = state.tcp_pose[:3]
    X_pendant_flange = DhParameters.of(config.arm.model, config.arm.calibration).fk(state.q)
    yield ok("TCP place", f"{BaseFrame.PENDANT_BASE} {_mm(tcp)}, {BaseFrame.BASE_LINK} {_mm(HALF_TURN[:3, :3] @ tcp)}")
    name = JOGGED_POINT
    if jogged_point is None:
        remedy = "jog the arm near the work, read X Y Z of the TCP (feature Base), and give --jogged-point X Y Z"
        yield warn(name, "the frames were not compared with the pendant", remedy)
        return
    away = float(np.linalg.norm(jogged_point - tcp))
    shown = f"the pendant shows {_mm(jogged_point)}"
    if away <= TOLERANCE:
        if np.hypot(tcp[0], tcp[1]) < ON_AXIS:
            remedy = "jog it away from the base's axis and read it again, because half a turn does not show there"
            yield warn(name, f"{shown}, as the robot reports", remedy)
        else:
            yield ok(name, f"{shown}, {away * 1e3:.1f} mm from what the robot reports in {BaseFrame.PENDANT_BASE}")
        return
    cause, remedy = _cause(jogged_point, tcp, X_pendant_flange[:3, 3], state, config.arm.model)
    yield fail(name, f"{shown}, {away * 1e3:.0f} mm from what the robot reports: {cause}", remedy)


def parse_point(text: str) -> Array | None:
    """Read a point as a person types it from the pendant.

    Args:
        text: X Y Z in millimetres, with spaces between them, or commas or semicolons followed by spaces.

    Returns:
        The point, (3,) [m]; None if the text is not three finite numbers.
    """
    try:
        point = 1e-3 * np.array([float(part) for part in re.split(r"[,;]?\s+", text.strip())])
    except ValueError:
        return None
    return point if point.shape == (3,) and np.all(np.isfinite(point)) else None


def _cause(point: Array, tcp: Array, flange: Array, state: UrState, model: ArmModel) -> tuple[str, str]:
    """Name the mistake that explains a reading best, and its remedy."""
    q, turn = state.q, HALF_TURN[:3, :3]
    other = next(m for m in ArmModel if m is not model)
    read_in_base = "read the Move screen with the feature Base and the TCP that is active there"
    causes = [
        (turn @ tcp, f"half a turn about z, this is {BaseFrame.BASE_LINK}", f"{read_in_base}; not ROS's base_link"),
        (
            flange,
            "it is the flange's position, without the TCP",
            "set the TCP in the installation to zero, read it again",
        ),
        (turn @ flange, "half a turn about z, and the flange without the TCP", read_in_base),
        (
            DhParameters.of(other).fk(q)[:3, 3],
            f"it is where the flange of a {other} would be",
            "set arm.model in the station file, or connect to the right robot",
        ),
        (1e-3 * tcp, "these are metres instead of millimetres", "give millimetres, as the pendant shows them"),
        (0.0254 * tcp, "these may be inches", "set the pendant to metric units and read it again"),
    ]
    place, cause, remedy = min(causes, key=lambda c: float(np.linalg.norm(point - c[0])))
    if np.linalg.norm(point - place) > TOLERANCE:
        lever = float(np.linalg.norm(point - flange))
        return (
            f"no known mistake explains it; it is {lever * 1e3:.0f} mm from the flange",
            f"another TCP or feature may be active at the pendant, or the arm moved since: {read_in_base}",
        )
    return cause, remedy


def _mm(place: Array) -> str:
    return "(" + ", ".join(f"{1e3 * value:.1f}" for value in place) + ") mm"


NAME = "mounting"
MOUNTING_TOLERANCE = np.radians(5.0)
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
    look = "compare the base with arm.up of the station file and with PolyScope's Mounting page"
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
    if off <= MOUNTING_TOLERANCE:
        return ok(NAME, message)
    if off >= np.pi - MOUNTING_TOLERANCE:
        # That what points upwards reads positive is one sentence of a manual, and was never seen on a robot.
        remedy = "check with a spirit level: if the base stands as arm.up says, this accelerometer has the other sign"
        return warn(NAME, f"{message}: upside down", f"{remedy}; please report it, and leave arm.up as it is")
    remedy = "correct arm.up, and set PolyScope's Mounting page before the brakes are released again"
    return fail(NAME, message, remedy)


def _text(direction: Array) -> str:
    x, y, z = direction / np.linalg.norm(direction) + 0.0
    return f"({x:.2f}, {y:.2f}, {z:.2f})".replace("-0.00", "0.00")
