"""The hand of a real station: the driver that its station file names.

with open_hand(load_lab_station(Path("lab.yaml")).hand, HostClock()) as hand:
    hand.open()
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator
from dataclasses import dataclass

from toolee_robot.devices.hands.ability import AbilityHand
from toolee_robot.devices.hands.inspire import InspireHand
from toolee_robot.devices.hands.inspire.tcp_port import is_tcp, tcp_address
from toolee_robot.devices.hands.mount import MountedTool
from toolee_robot.devices.hands.shadow import ShadowHand
from toolee_robot.devices.hands.shadow.efforts import read_efforts
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, Hand
from toolee_robot.robots import MOUNT, HandModel, hand_model
from toolee_robot.robots.hands.ability import ABILITY
from toolee_robot.robots.hands.inspire import INSPIRE
from toolee_robot.robots.hands.shadow import SHADOW
from toolee_robot.runtime.device_plugins import installed, load
from toolee_robot.station import HandConfig
from toolee_robot.types import HandEfforts


@dataclass(frozen=True)
class WiredHandKind:
    """A kind of hand on a wire: its driver, and where it is found.

    Attributes:
        driver: Builds the driver from model, port, the station file's `hand`, and clock.
        ports: What its port may be, for people.
        scheme: Scheme of its port if that is an address, such as tcp; None for a serial port only.
        hand_id: Number with which its maker delivers it; None for a hand without one.
        measured_efforts: Whether a lab must measure what its efforts mean.
    """

    driver: Callable[[HandModel, str, HandConfig, Clock], Hand]
    ports: str
    scheme: str | None = None
    hand_id: int | None = None
    measured_efforts: bool = False


def _number(config: HandConfig) -> int:
    kind = wired_hand(config.model)
    number = config.hand_id if config.hand_id is not None or kind is None else kind.hand_id
    assert number is not None
    return number


def _inspire(model: HandModel, port: str, config: HandConfig, clock: Clock) -> Hand:
    return InspireHand(model, port, clock, _number(config))


def _ability(model: HandModel, port: str, config: HandConfig, clock: Clock) -> Hand:
    return AbilityHand(model, port, clock, _number(config))


def _shadow(model: HandModel, port: str, config: HandConfig, clock: Clock) -> Hand:
    if config.efforts is None:
        lacking = ", ".join(f"hand.efforts.{name}" for name in HandEfforts.__dataclass_fields__)
        message = f"nobody but the lab knows what the efforts of its {model.label} mean: measure and give {lacking}"
        raise ConfigError(f"{message}; docs/how-to/shadow_hand.md", code="config.hand_efforts")
    return ShadowHand(model, port, config.efforts, clock)


_SERIAL = "the serial port, such as /dev/ttyUSB0"
WIRED_HANDS: dict[str, WiredHandKind] = {
    INSPIRE: WiredHandKind(_inspire, f"{_SERIAL}, or tcp://HOST:PORT of one with Ethernet", "tcp", 1),
    ABILITY: WiredHandKind(_ability, _SERIAL, hand_id=0x50),
    SHADOW: WiredHandKind(_shadow, "the address of its rosbridge, such as ws://HOST:9090", "ws", measured_efforts=True),
}
"""Name in the station file -> hand on a wire."""
_ENTRIES = "hand"
"""Kind of the entry points by which packages bring drivers."""


def wired_hand(model: str) -> WiredHandKind | None:
    """Look up a kind of hand on a wire: one of `WIRED_HANDS`, or one that an installed package names.

    Args:
        model: Its name in the station file.

    Returns:
        The kind; None where there is none of that name, or its package brings a driver alone.

    Raises:
        ConfigError: What a package names cannot be imported (`config.device_plugin`).
    """
    if model in WIRED_HANDS:
        return WIRED_HANDS[model]
    entry = installed(_ENTRIES).get(model)
    found = None if entry is None else load(entry)
    return found if isinstance(found, WiredHandKind) else None


def open_hand(config: HandConfig, clock: Clock) -> Hand:
    """Build the driver of a station's hand.

    A package of a lab may bring one: an entry point `hand.NAME` of the group `toolee_robot.devices` for the hand that a
    station file calls NAME. It names a `WiredHandKind`; or what takes model, station file's `hand` and clock, and
    builds the driver. Its model is `hand_model.NAME`, its emulator for rehearsals `hand_emulator.NAME`.

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
    kind = wired_hand(config.model)
    if kind is None:
        plugins = installed(_ENTRIES)
        if config.model in plugins:
            hand: Hand = load(plugins[config.model])(model, config, clock)
            return hand
        known = ", ".join((*WIRED_HANDS, *plugins, MOUNT))
        message = f"the {model.label} has no driver here: those with one are {known}; docs/how-to/add_a_hand.md"
        raise ConfigError(message, code="config.hand_driver")
    port = _port(config, kind)
    _check_address(config, kind)
    return kind.driver(model, port, config, clock)


def efforts_of(config: HandConfig, clock: Clock) -> Generator[Array]:
    """Read the efforts of a hand of which a lab must measure what they mean; nothing is moved.

    Args:
        config: What the station file says of the hand; `efforts` may be missing.
        clock: The station's clock, the host's.

    Returns:
        Effort of each motor as they come, (20,) [in the hand's unit].

    Raises:
        UserError: The hand's maker says what its forces mean (`user.no_efforts`).
        ConfigError: The port is missing, or none of this hand.
    """
    kind = wired_hand(config.model)
    if kind is None or not kind.measured_efforts:
        message = f"{config.model} has no hand.efforts to measure: `toolee hand state` shows its forces in newtons"
        raise UserError(message, code="user.no_efforts")
    _check_address(config, kind)
    return read_efforts(_port(config, kind), clock)


def _port(config: HandConfig, kind: WiredHandKind) -> str:
    if config.port is None:
        message = f"hand.port of the {hand_model(config).label} is missing: {kind.ports}"
        raise ConfigError(message, code="config.hand_port")
    return config.port


def _check_address(config: HandConfig, kind: WiredHandKind) -> None:
    """Refuse a port or a number that a kind of hand cannot have."""
    if config.hand_id is not None and kind.hand_id is None:
        message = f"hand.hand_id: {config.model} has no number, its port is an address; remove the field"
        raise ConfigError(message, code="config.hand_id")
    if config.port is not None and "://" in config.port:
        if config.port.partition("://")[0] != kind.scheme:
            message = f"hand.port {config.port!r} is not for {config.model}: give {kind.ports}"
            raise ConfigError(message, code="config.hand_port")
        if is_tcp(config.port):
            tcp_address(config.port)
    elif config.port is not None and kind.scheme is not None and re.fullmatch(r"[\w.-]+:\d+", config.port):
        message = f"hand.port {config.port!r} is no serial port: write {kind.scheme}://{config.port}"
        raise ConfigError(message, code="config.hand_port")


def hand_drivers() -> dict[str, str]:
    """The hands that a station file may name and that have a driver, and where each is from."""
    others = {name: entry.value for name, entry in installed(_ENTRIES).items()}
    return others | dict.fromkeys((*WIRED_HANDS, MOUNT), "toolee_robot")
