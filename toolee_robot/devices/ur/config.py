"""Configuration of the UR driver: robot address, servo, expected installation."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

from pydantic import TypeAdapter, ValidationError

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.clock import HostClock, check_real_time_factor
from toolee_robot.station import ServoConfig
from toolee_robot.types import Payload


@dataclass(frozen=True)
class UrArmConfig:
    """Settings of one UR arm's driver.

    Attributes:
        host: Address of the controller; its ports are fixed.
        servo: Parameters of the servo, its lag, and the timeouts; those of the station file.
        longest_motion: Longest duration of one motion [s].
        payload: Payload that the robot's installation must have at the start, or None for no check. The driver sets its
            own; the installation's applies to programs that are started at the pendant.
        tcp: TCP that the robot's installation must have at the start: x, y, z [m] and rotation vector [rad] in the
            flange frame. None for no check.
        real_time_factor: Real-time factor of the station's clock. Other than 1 only for a stand-in on a loopback
            address that runs at the same factor.
    """

    host: str
    servo: ServoConfig = field(default_factory=ServoConfig)
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
        try:
            TypeAdapter(ServoConfig).validate_python(asdict(self.servo))
        except ValidationError as error:
            wrong = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
            raise ConfigError(f"the servo's parameters are invalid: {wrong}", code="config.servo") from error
        if not self.longest_motion > 0.0:
            raise ConfigError("longest_motion must be positive")

    @property
    def clock(self) -> HostClock:
        """The station's clock, which the driver uses for all its times."""
        return HostClock(self.real_time_factor)
