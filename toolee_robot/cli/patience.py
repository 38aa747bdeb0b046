"""How late things may be where one computer is robot, world and task at once, as no real station is.

On a robot PC with a robot at the other end of the cable the usual bounds hold; here they would end a job because
another program wants the processor. What a late sample or a late task leads to stays the same.
"""

from __future__ import annotations

from dataclasses import replace

from toolee_robot.config import StationConfig, SupervisorConfig
from toolee_robot.hardware.ur_config import UrArmConfig, servo_rate
from toolee_robot.types import ArmModel

LATE = 0.2
"""[s] that a stand-in's data may be late, commands with them, and the joints behind their commands."""


def patient_bounds(config: StationConfig) -> SupervisorConfig:
    """The supervisor's bounds of a station behind a stand-in."""
    bounds, cycles = config.supervisor, LATE * servo_rate(5 if config.arm.model is ArmModel.UR10E else 3)
    return replace(
        bounds,
        tracking_error=bounds.tracking_error + LATE * max(config.arm.velocity),
        data_cycles=max(bounds.data_cycles, cycles),
        overruns=max(bounds.overruns, round(cycles)),
        max_data_age=max(bounds.max_data_age, 2 * LATE),
    )


def patient_driver(host: str) -> UrArmConfig:
    """The driver of an arm behind a stand-in on `host`."""
    return UrArmConfig(
        host,
        watchdog=2.0,
        connect_timeout=15.0,
        handshake_timeout=5.0,
        hang_timeout=1.0,
        heartbeat_timeout=1.0,
    )
