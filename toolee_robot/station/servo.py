"""The arm's servo: what the driver tells the controller with every command, and how long it waits for what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from toolee_robot.station.values import STRICT, NotNegative, Positive


@dataclass(frozen=True)
class ServoConfig:
    """Parameters of URScript's servoj, the measured lag, and the timeouts of the driver.

    Gain and lookahead are servoj's own defaults. A higher gain and a shorter lookahead follow a strike more closely and
    may make the arm vibrate (Universal Robots, Script manual, "servoj"): change them with `toolee arm lag` only.

    All times are on the station's clock, except `link_timeout`, which is on the wall clock as ur_rtde's own timeout is.
    """

    __pydantic_config__ = STRICT
    gain: Annotated[float, Field(ge=100, le=2000)] = 300.0
    """Proportional gain of servoj."""
    lookahead: Annotated[float, Field(ge=0.03, le=0.2)] = 0.1
    """Lookahead time of servoj, which smooths the path [s]."""
    lag: NotNegative | None = None
    """Delay of a measured position behind its command with this gain and lookahead, network included [s]; None: it was
    not measured yet, and the driver assumes an upper bound (`servo_lag`)."""
    watchdog: Positive = 10.0
    """Rate of the robot's watchdog: the robot stops the program when no command comes for 1/watchdog s [Hz]."""
    connect_timeout: Positive = 3.0
    """Timeout of the connection, from the start of the servo process's attempt [s]."""
    handshake_timeout: Positive = 1.0
    """Timeout of every call that the control script acknowledges: payload, TCP, zero of the force, freedrive, end of
    the program [s]."""
    link_timeout: Annotated[float, Field(gt=0, lt=2.5)] = 1.5
    """Time without new data at rest after which the link counts as lost; below 2.5 s, after which ur_rtde itself
    reconnects [s]."""
    hang_timeout: Positive = 0.2
    """Time without progress of the servo loop after which the servo process counts as hung [s]."""
    heartbeat_timeout: Positive = 0.1
    """Time without a heartbeat of the task's process after which the arm stops [s]."""


def servo_lag(servo: ServoConfig, rate: float) -> float:
    """Upper bound of the delay of a measured position behind its command.

    Args:
        servo: The servo's parameters.
        rate: The controller's rate [Hz].

    Returns:
        The measured lag [s]. Until it is measured an assumed bound: the lookahead, 25 s divided by the gain for the
        proportional law, and three cycles; with the defaults 0.19 s at 500 Hz and 0.21 s at 125 Hz. Measured elsewhere:
        34 ms on a UR10e with 0.03 s and a gain of 1200 (Universal Robots client library, issue 86), which it bounds by
        57 ms.
    """
    return servo.lookahead + 25.0 / servo.gain + 3.0 / rate if servo.lag is None else servo.lag
