"""The hand of a real station: the driver that its station file names.

with open_hand(load_lab_station(Path("lab.yaml")).hand, HostClock()) as hand:
    hand.open()
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from toolee_robot.config import HandConfig
from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, Hand
from toolee_robot.hardware.hands.ability import AbilityHand
from toolee_robot.hardware.hands.inspire import InspireHand
from toolee_robot.hardware.hands.mount import MountedTool
from toolee_robot.robots import MOUNT, HandModel, hand_model
from toolee_robot.robots.hands.ability import ABILITY, joints_of_closures
from toolee_robot.robots.hands.inspire import INSPIRE, joints_of_counts
from toolee_robot.sim_backend.ability_hand import AbilityEmulator
from toolee_robot.sim_backend.hand_wire import HandEmulator
from toolee_robot.sim_backend.inspire_hand import InspireEmulator
from toolee_robot.stations.devices import installed, load


@dataclass(frozen=True)
class WiredHandKind:
    """A kind of hand on a wire: its driver, and what stands in for the hand at the other end.

    Attributes:
        driver: Builds the driver from model, port, clock, and number of the hand.
        emulator: Builds the emulated hand with that number, a seed of its noise, and the rate of its motors' time.
        joints: Converts the emulated motors' angles to the positions of the model's joints [rad].
        hand_id: Number with which its maker delivers it.
    """

    driver: Callable[[HandModel, str, Clock, int], Hand]
    emulator: Callable[[int, int, float], HandEmulator[Any]]
    joints: Callable[[Array], Array]
    hand_id: int


WIRED_HANDS: dict[str, WiredHandKind] = {
    INSPIRE: WiredHandKind(InspireHand, InspireEmulator, joints_of_counts, 1),
    ABILITY: WiredHandKind(AbilityHand, AbilityEmulator, joints_of_closures, 0x50),
}
"""Name in the station file -> hand on a wire."""


def open_hand(config: HandConfig, clock: Clock) -> Hand:
    """Build the driver of a station's hand.

    A package of a lab may bring one: an entry point `hand.NAME` of the group `toolee_robot.devices` that takes model,
    station file's `hand` and clock, for the hand that a station file calls NAME.

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
    if config.model not in WIRED_HANDS:
        plugins = installed("hand")
        if config.model in plugins:
            hand: Hand = load(plugins[config.model])(model, config, clock)
            return hand
        known = ", ".join((*WIRED_HANDS, *plugins, MOUNT))
        message = f"the {model.label} has no driver here: those with one are {known}; docs/how-to/add_a_hand.md"
        raise ConfigError(message, code="config.hand_driver")
    if config.port is None:
        message = f"hand.port is missing: the serial port of the {model.label}, such as /dev/ttyUSB0"
        raise ConfigError(message, code="config.hand_port")
    kind = WIRED_HANDS[config.model]
    return kind.driver(model, config.port, clock, config.hand_id or kind.hand_id)


def emulated_hand(config: HandConfig, seed: int = 0, pace: float = 1.0) -> HandEmulator[Any]:
    """Build the emulated hand that stands in for a station's.

    Args:
        config: What the station file says of the hand.
        seed: Seed of its noise.
        pace: Rate of its motors' time relative to the host's.

    Returns:
        The emulated hand, not yet entered.

    Raises:
        ConfigError: The hand has no emulator.
    """
    if config.model not in WIRED_HANDS:
        known = ", ".join(WIRED_HANDS)
        raise ConfigError(f"no emulator of {config.model!r}: there is one of {known}", code="config.hand_driver")
    kind = WIRED_HANDS[config.model]
    return kind.emulator(config.hand_id or kind.hand_id, seed, pace)


def hand_drivers() -> dict[str, str]:
    """The hands that a station file may name and that have a driver, and where each is from."""
    others = {name: entry.value for name, entry in installed("hand").items()}
    return others | dict.fromkeys((*WIRED_HANDS, MOUNT), "toolee_robot")
