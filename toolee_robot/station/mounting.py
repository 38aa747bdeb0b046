"""How the arm's base stands in the world: gravity in `base`, and what needs a base that stands upright."""

from __future__ import annotations

import numpy as np

from toolee_robot.errors import ConfigError
from toolee_robot.station.robot import ArmLimits

UPRIGHT_WITHIN = np.radians(1.0)
"""Largest tilt of a base that counts as upright [rad]. Across the base's z it leaves 0.17 N of each kilogram that the
flange carries: 0.9 N of a hand of 5 kg."""


def check_upright(arm: ArmLimits, purpose: str) -> None:
    """Refuse a tilted base for what takes z of `base` for straight up.

    Args:
        arm: The arm.
        purpose: What needs an upright base.

    Raises:
        ConfigError: The base is tilted (`config.mounting_tilted`).
    """
    if arm.tilt > UPRIGHT_WITHIN:
        raise ConfigError(
            f"arm.up {list(arm.up)}: the base is tilted by {np.degrees(arm.tilt):.1f}°, and {purpose} takes z of "
            f"`base` for straight up: it needs an arm that stands upright to {np.degrees(UPRIGHT_WITHIN):.0f}°; if "
            "yours does, correct arm.up",
            code="config.mounting_tilted",
        )
