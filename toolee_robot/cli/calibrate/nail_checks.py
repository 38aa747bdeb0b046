"""What is refused of a location of a nail: an incomplete station file, far touches."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from toolee_robot.calibration.record import axes_swapped, camera_is_elsewhere, half_a_turn_apart
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import Array
from toolee_robot.station import StationConfig, load_lab_station, unmeasured

FARTHEST = 0.050
"""Largest distance of the nail from the circle around the touches of the wood [m]: a rise that is known to 0.5 degrees
is worth 0.4 mm of height there."""


def touched_station(path: Path, *, wood_alone: bool) -> StationConfig:
    """Load the station file of a lab whose nail or wood was touched.

    Args:
        path: The file, of the present version; it may leave out what touches do not need.
        wood_alone: Whether only the wood was touched, so that the file says where the nail is.

    Returns:
        The station.

    Raises:
        ConfigError: As `load_lab_station`, or the file leaves out which arm it is, how its base stands, or where the
            nail is although only the wood was touched (`config.unmeasured`).
    """
    config = load_lab_station(path, complete=False)
    needed = ["arm.model", "arm.up", *(["work.nail_xy"] if wood_alone else [])]
    left_out = unmeasured(path)
    if missing := [name for name in needed if name in left_out]:
        head = ", or touch the nail's head, too (--touches)" if "work.nail_xy" in missing else ""
        raise ConfigError(
            f"{path} leaves out {', '.join(missing)}, and the simulated station's values would stand in: measure and "
            f"give them{head}; `toolee station check {path}` says how",
            code="config.unmeasured",
        )
    return config


def check_near(places: Array, at: Array) -> None:
    """Refuse touches of the wood that are not around the nail, where its height would be extrapolated.

    Args:
        places: x and y of the touches in `base`, (N, 2) [m].
        at: The nail's, (2,) [m].

    Raises:
        UserError: The nail is more than 50 mm outside the circle around the touches' mean that holds them all
            (`user.wood_far`).
    """
    middle = np.mean(places, axis=0)
    radius = np.max(np.linalg.norm(places - middle, axis=1))
    off = float(np.linalg.norm(at - middle) - radius)
    if off > FARTHEST:
        raise UserError(
            f"the nail at ({at[0]:.3f}, {at[1]:.3f}) m in base_link is {off * 1e3:.0f} mm outside the circle around "
            f"the touches of the wood, whose middle is ({middle[0]:.3f}, {middle[1]:.3f}), and "
            f"{FARTHEST * 1e3:.0f} mm are allowed: touch the wood around the nail, or correct the nail's place "
            "(work.nail_xy, or its touches)",
            code="user.wood_far",
        )


def mistake(entry: Array, by_file: Array) -> str:
    """Name the mistake that explains why a nail is far from where the station file has it.

    Args:
        entry: Where its axis meets the wood, in `base`, (3,) [m].
        by_file: The same by the station file, (3,) [m].

    Returns:
        The mistake in words; empty where the file is near, or no usual one explains it.
    """
    if not camera_is_elsewhere(entry, by_file):
        return ""
    if half_a_turn_apart(entry, by_file):
        return "half a turn of the base: the file's positions are of the other `frame`"
    return "x and y are swapped there: look at the file's other positions, too" if axes_swapped(entry, by_file) else ""
