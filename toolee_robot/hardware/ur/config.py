"""Configuration of the UR driver: robot address, servo settings, timeouts."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.clock import HostClock, check_real_time_factor
from toolee_robot.types import Payload


@dataclass(frozen=True)
class UrArmConfig:
    """Settings of one UR arm's driver.

    All times are on the station's clock, except `link_timeout`, which is on the wall clock as ur_rtde's own timeout is.

    Attributes:
        host: Address of the controller; its ports are fixed.
        lookahead: Lookahead time of servoj [s], 0.03 to 0.2. The smallest value follows a strike best.
        gain: Gain of servoj, 100 to 2000.
        lag: Upper bound of the delay of a measured position behind its command [s], network and servo included; the
            tracking error is evaluated with this delay allowed for. None for the default of `servo_lag`.
        watchdog: Rate of the robot's watchdog [Hz]: the robot stops the program when no command comes for 1/watchdog s.
        connect_timeout: Timeout of the connection [s], from the start of the servo process's attempt.
        handshake_timeout: Timeout of every call that the control script acknowledges (payload, freedrive, end of the
            program) [s].
        link_timeout: Time without new data at rest after which the link counts as lost [s]; below 2.5 s, after which
            ur_rtde itself reconnects.
        hang_timeout: Time without progress of the servo loop after which the servo process counts as hung [s].
        heartbeat_timeout: Time without a heartbeat of the task's process after which the arm stops [s].
        longest_motion: Longest duration of one motion [s].
        payload: Payload that the robot's installation must have at the start, or None for no check. The driver sets its
            own; the installation's applies to programs that are started at the pendant.
        tcp: TCP that the robot's installation must have at the start: x, y, z [m] and rotation vector [rad] in the
            flange frame. None for no check.
        real_time_factor: Real-time factor of the station's clock. Other than 1 only for a stand-in on a loopback
            address that runs at the same factor.
    """

    host: str
    lookahead: float = 0.03
    gain: float = 2000.0
    lag: float | None = None
    watchdog: float = 10.0
    connect_timeout: float = 3.0
    handshake_timeout: float = 1.0
    link_timeout: float = 1.5
    hang_timeout: float = 0.2
    heartbeat_timeout: float = 0.1
    longest_motion: float = 120.0
    payload: Payload | None = None
    tcp: tuple[float, float, float, float, float, float] | None = None
    real_time_factor: float = 1.0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ConfigError: A value is out of range.
            UserError: The real-time factor is invalid for this host.
        """
        check_real_time_factor(self.real_time_factor, self.host)
        if not 0.03 <= self.lookahead <= 0.2:
            raise ConfigError(f"lookahead {self.lookahead} s: servoj takes 0.03 to 0.2", code="config.lookahead")
        if not 100 <= self.gain <= 2000:
            raise ConfigError(f"gain {self.gain}: servoj takes 100 to 2000", code="config.gain")
        if not 0 < self.link_timeout < 2.5:
            raise ConfigError(
                f"link_timeout {self.link_timeout} s: must be between 0 and 2.5, when ur_rtde reconnects",
                code="config.link_timeout",
            )
        positive = (
            *(self.watchdog, self.connect_timeout, self.handshake_timeout),
            *(self.hang_timeout, self.heartbeat_timeout, self.longest_motion),
        )
        if min(positive) <= 0 or (self.lag is not None and self.lag < 0):
            raise ConfigError(
                "timeouts, the watchdog's rate and longest_motion must be positive, the lag not negative",
                code="config.ur_timing",
            )

    @property
    def clock(self) -> HostClock:
        """The station's clock, which the driver uses for all its times."""
        return HostClock(self.real_time_factor)


def servo_lag(config: UrArmConfig, rate: float) -> float:
    """Upper bound of the servo's delay.

    Args:
        config: The driver's settings.
        rate: The controller's rate [Hz].

    Returns:
        The configured lag, or by default servoj's lookahead plus three cycles [s].
    """
    return config.lookahead + 3.0 / rate if config.lag is None else config.lag
