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
from toolee_robot.hardware.hands.shadow import ShadowHand
from toolee_robot.robots import MOUNT, HandModel, hand_model
from toolee_robot.robots.hands.ability import ABILITY, joints_of_closures
from toolee_robot.robots.hands.inspire import INSPIRE, joints_of_counts
from toolee_robot.robots.hands.shadow import SHADOW, joints_of_motors
from toolee_robot.sim_backend.ability_hand import AbilityEmulator
from toolee_robot.sim_backend.hand_wire import HandEmulator
from toolee_robot.sim_backend.inspire_hand import InspireEmulator
from toolee_robot.sim_backend.shadow_hand import ShadowEmulator
from toolee_robot.stations.devices import installed, load
from toolee_robot.types import HandEfforts


@dataclass(frozen=True)
class WiredHandKind:
    """A kind of hand on a wire: its driver, and what stands in for the hand at the other end.

    Attributes:
        driver: Builds the driver from model, port, the station file's `hand`, and clock.
        emulator: Builds the emulated hand from the station file's `hand`, a seed of its noise, and the rate of its
            motors' time.
        joints: Converts the emulated motors' angles to the positions of the model's joints [rad].
        port: What its port is, for people.
    """

    driver: Callable[[HandModel, str, HandConfig, Clock], Hand]
    emulator: Callable[[HandConfig, int, float], HandEmulator[Any]]
    joints: Callable[[Array], Array]
    port: str = "the serial port, such as /dev/ttyUSB0"


def _shadow(model: HandModel, port: str, config: HandConfig, clock: Clock) -> Hand:
    if config.hand_id is not None:
        message = f"hand.hand_id: the {model.label} has no number, its rosbridge an address; remove the field"
        raise ConfigError(message, code="config.hand_id")
    if config.efforts is None:
        lacking = ", ".join(f"hand.efforts.{name}" for name in HandEfforts.__dataclass_fields__)
        message = f"nobody but the lab knows what the efforts of its {model.label} mean: measure and give {lacking}"
        raise ConfigError(f"{message}; docs/how-to/shadow_hand.md", code="config.hand_efforts")
    return ShadowHand(model, port, config.efforts, clock)


WIRED_HANDS: dict[str, WiredHandKind] = {
    INSPIRE: WiredHandKind(
        lambda model, port, config, clock: InspireHand(model, port, clock, config.hand_id or 1),
        lambda config, seed, pace: InspireEmulator(config.hand_id or 1, seed, pace),
        joints_of_counts,
    ),
    ABILITY: WiredHandKind(
        lambda model, port, config, clock: AbilityHand(model, port, clock, config.hand_id or 0x50),
        lambda config, seed, pace: AbilityEmulator(config.hand_id or 0x50, seed, pace),
        joints_of_closures,
    ),
    SHADOW: WiredHandKind(
        _shadow,
        lambda _, seed, pace: ShadowEmulator(seed, pace),
        joints_of_motors,
        "the address of its rosbridge, such as ws://HOST:9090",
    ),
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
        ConfigError: The hand is unknown or has no driver, or the station file lacks its port, mounting or efforts.
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
        message = f"hand.port of the {model.label} is missing: {WIRED_HANDS[config.model].port}"
        raise ConfigError(message, code="config.hand_port")
    return WIRED_HANDS[config.model].driver(model, config.port, config, clock)


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
    return WIRED_HANDS[config.model].emulator(config, seed, pace)


def hand_drivers() -> dict[str, str]:
    """The hands that a station file may name and that have a driver, and where each is from."""
    others = {name: entry.value for name, entry in installed("hand").items()}
    return others | dict.fromkeys((*WIRED_HANDS, MOUNT), "toolee_robot")
