"""The limits of the safety system."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SafetyLimits:
    """Limits whose violation causes a protective stop.

    Attributes:
        force: Force on the flange [N], low-pass filtered: as estimated from joint currents, a strike appears weaker.
        force_time: Time constant of that filter [s].
        following_error: Deviation of a joint from its set-point [rad].
        joint_speed: Joint velocity as a fraction of the model's limit.
        tcp_speed: Speed of the TCP [m/s].
    """

    force: float = 150.0
    force_time: float = 0.02
    following_error: float = 0.2
    joint_speed: float = 1.1
    tcp_speed: float = 5.0
