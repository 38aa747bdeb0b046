"""The arm's servo: what the driver tells the controller with every command, and how long it waits for what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from toolee_robot.station.values import STRICT
from toolee_robot.types.units import Number, Seconds, Unit


@dataclass(frozen=True)
class ServoConfig:
    """Parameters of URScript's servoj, the measured lag, and the timeouts of the driver.

    Gain and lookahead are servoj's own defaults. A higher gain and a shorter lookahead follow a strike more closely and
    may make the arm vibrate (Universal Robots, Script manual, "servoj"): change them with `toolee arm lag` only.

    All times are on the station's clock, except `link_timeout`, which is on the wall clock as ur_rtde's own timeout is.
    """

    __pydantic_config__ = STRICT
    gain: Annotated[float, Number(100.0, 2000.0, "Script manual, servoj")] = 300.0
    """Proportional gain of servoj."""
    lookahead: Annotated[float, Seconds(0.03, 0.2, "Script manual, servoj")] = 0.1
    """Lookahead time of servoj, which smooths the path."""
    lag: Annotated[float, Seconds(0.002, 0.5, "UR arms follow within 0.03 to 0.25 s")] | None = None
    """Delay of a measured position behind its command with this gain and lookahead, network included; None: it was
    not measured yet, and the driver assumes an upper bound (`servo_lag`)."""
    watchdog: Annotated[float, Unit("Hz", 2.0, 100.0, "without commands the arm goes on for 1/watchdog s")] = 10.0
    """Rate of the robot's watchdog: the robot stops the program when no command comes for 1/watchdog s."""
    connect_timeout: Annotated[float, Seconds(0.1, 60.0)] = 3.0
    """Timeout of the connection, from the start of the servo process's attempt."""
    handshake_timeout: Annotated[float, Seconds(0.05, 30.0)] = 1.0
    """Timeout of every call that the control script acknowledges: payload, TCP, zero of the force, freedrive, end of
    the program."""
    link_timeout: Annotated[float, Seconds(0.05, 2.4, "after 2.5 s ur_rtde itself reconnects")] = 1.5
    """Time without new data at rest after which the link counts as lost; below 2.5 s, after which ur_rtde itself
    reconnects."""
    hang_timeout: Annotated[float, Seconds(0.02, 2.0)] = 0.2
    """Time without progress of the servo loop after which the servo process counts as hung."""
    heartbeat_timeout: Annotated[float, Seconds(0.02, 1.0, "the arm goes on for as long")] = 0.1
    """Time without a heartbeat of the task's process after which the arm stops."""


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
