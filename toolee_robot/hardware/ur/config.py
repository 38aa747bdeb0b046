"""What a UR arm's driver has to know about its robot, its network and its servo."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.clock import HostClock, check_real_time_factor
from toolee_robot.types import Payload


@dataclass(frozen=True)
class UrArmConfig:
    """host: the controller's address. The ports are fixed by the controller.

    lookahead [s] (0.03 to 0.2) and gain (100 to 2000): of servoj; the smallest lookahead follows a strike best.
    lag: the most by which a measured position comes later than its command [s], network and servo included; it is taken
    off before a tracking error is judged. None: as `servo_lag` says.
    watchdog: the robot stops the program when it gets no command for 1/watchdog [Hz].
    connect_timeout: for the connection, once the servo process runs [s]. handshake_timeout: for anything that the
    control script has to acknowledge: payload, freedrive, the end [s]. link_timeout: at rest, no new data for so long
    is a lost link [s]; ur_rtde itself gives up after 2.5 s and is then not to be trusted. hang_timeout: in motion, no
    sign of life of the servo process for so long is a crash [s]. heartbeat_timeout: the task's process shows no life
    for so long, and the arm brakes [s]. longest_motion [s].
    payload, tcp: what the robot's installation must say at the start, tcp as x, y, z [m] and rotation vector [rad] in
    the flange frame; None where it is not looked at: the driver sets its own, but what the pendant's programs run with
    is the installation's.
    real_time_factor: of the station's clock, on which all these times are, but for link_timeout, which is the wall's as
    ur_rtde's own is; other than 1 only for a stand-in on a loopback address that runs at the same real-time factor."""

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
        """Raises ConfigError, or UserError for the real-time factor."""
        check_real_time_factor(self.real_time_factor, self.host)
        if not 0.03 <= self.lookahead <= 0.2:
            raise ConfigError(f"lookahead {self.lookahead} s: servoj takes 0.03 to 0.2")
        if not 100 <= self.gain <= 2000:
            raise ConfigError(f"gain {self.gain}: servoj takes 100 to 2000")
        if not 0 < self.link_timeout < 2.5:
            raise ConfigError(f"link_timeout {self.link_timeout} s: must be under 2.5, when ur_rtde gives up")
        positive = (
            *(self.watchdog, self.connect_timeout, self.handshake_timeout),
            *(self.hang_timeout, self.heartbeat_timeout, self.longest_motion),
        )
        if min(positive) <= 0 or (self.lag is not None and self.lag < 0):
            raise ConfigError("timeouts, the watchdog's rate and longest_motion must be positive, the lag not negative")

    @property
    def clock(self) -> HostClock:
        """Of everything that this driver does."""
        return HostClock(self.real_time_factor)


def servo_lag(config: UrArmConfig, rate: float) -> float:
    """[s] The configured lag, or the usual one: servoj's lookahead and three cycles."""
    return config.lookahead + 3.0 / rate if config.lag is None else config.lag
