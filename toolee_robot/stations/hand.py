"""The hand of a real station: the driver that its station file names.

with open_hand(load_lab_station(Path("lab.yaml")).hand, HostClock()) as hand:
    hand.open()
"""

from __future__ import annotations

from collections.abc import Callable

from toolee_robot.config import HandConfig
from toolee_robot.errors import ConfigError
from toolee_robot.hal import Clock, Hand
from toolee_robot.hardware.hands.inspire import InspireHand
from toolee_robot.hardware.hands.mount import MountedTool
from toolee_robot.robots import MOUNT, HandModel, hand_model
from toolee_robot.robots.hands.inspire import INSPIRE


def open_hand(config: HandConfig, clock: Clock) -> Hand:
    """Build the driver of a station's hand.

    Args:
        config: What the station file says of the hand.
        clock: The station's clock, the host's.

    Returns:
        The driver, not yet entered; entering it opens its port, and moves nothing.

    Raises:
        ConfigError: The hand is unknown or has no driver, or the station file lacks its port or its mounting.
    """
    model = hand_model(config)
    if config.model == MOUNT:
        return MountedTool(model, clock)
    if config.model not in _DRIVERS:
        known = ", ".join((*_DRIVERS, MOUNT))
        message = f"the {model.label} has no driver here: those with one are {known}; docs/how-to/add_a_hand.md"
        raise ConfigError(message, code="config.hand_driver")
    if config.port is None:
        message = f"hand.port is missing: the serial port of the {model.label}, such as /dev/ttyUSB0"
        raise ConfigError(message, code="config.hand_port")
    return _DRIVERS[config.model](model, config.port, clock, config.hand_id)


def hand_drivers() -> dict[str, str]:
    """The hands that a station file may name and that have a driver, and where each is from: this project."""
    return dict.fromkeys((*_DRIVERS, MOUNT), "toolee_robot")


_DRIVERS: dict[str, Callable[[HandModel, str, Clock, int], Hand]] = {INSPIRE: InspireHand}
