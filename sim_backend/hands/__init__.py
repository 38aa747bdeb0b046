"""Emulated hands: what stands in for a station's hand at the other end of its driver's wire.

with emulated_hand(config.hand) as emulator:
    open_hand(replace(config.hand, port=emulator.port), clock)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from toolee_robot.errors import ConfigError
from toolee_robot.robots.hands.ability import ABILITY
from toolee_robot.robots.hands.inspire import INSPIRE
from toolee_robot.robots.hands.shadow import SHADOW
from toolee_robot.runtime.device_plugins import installed, load
from toolee_robot.sim_backend.ability_hand import AbilityEmulator
from toolee_robot.sim_backend.hand_wire import HandEmulator
from toolee_robot.sim_backend.inspire_hand import InspireEmulator, ModbusEmulator
from toolee_robot.sim_backend.shadow_hand import ShadowEmulator
from toolee_robot.station import HandConfig

Address = tuple[str, int]
"""Host and port."""
LOOPBACK: Address = ("127.0.0.1", 0)
"""Where an emulated hand on TCP listens if nobody says otherwise."""
Build = Callable[[HandConfig, Address, int, float], HandEmulator[Any]]
"""Builds an emulated hand from the station file's `hand`, where it listens on TCP, seed and pace."""
_ENTRIES = "hand_emulator"
"""Kind of the entry points by which packages bring emulators."""


def _inspire(config: HandConfig, listen: Address, seed: int, pace: float) -> HandEmulator[Any]:
    number = config.hand_id or 1
    if config.port is not None and config.port.startswith("tcp://"):
        return ModbusEmulator(listen, number, seed, pace)
    return InspireEmulator(number, seed, pace)


def _ability(config: HandConfig, _: Address, seed: int, pace: float) -> HandEmulator[Any]:
    return AbilityEmulator(config.hand_id or 0x50, seed, pace)


def _shadow(_: HandConfig, listen: Address, seed: int, pace: float) -> HandEmulator[Any]:
    return ShadowEmulator(seed, pace, listen)


EMULATORS: dict[str, Build] = {INSPIRE: _inspire, ABILITY: _ability, SHADOW: _shadow}
"""Name in the station file -> its emulator."""


def find_emulator(model: str) -> Build | None:
    """Look up an emulator: one of `EMULATORS`, or one that an installed package brings (`hand_emulator.NAME`).

    Args:
        model: The hand's name in the station file.

    Returns:
        What builds it; None where there is none.

    Raises:
        ConfigError: What a package names cannot be imported (`config.device_plugin`).
    """
    if model in EMULATORS:
        return EMULATORS[model]
    entry = installed(_ENTRIES).get(model)
    build: Build | None = None if entry is None else load(entry)
    return build


def emulated_hand(
    config: HandConfig, seed: int = 0, pace: float = 1.0, listen: Address = LOOPBACK
) -> HandEmulator[Any]:
    """Build the emulated hand that stands in for a station's.

    Args:
        config: What the station file says of the hand; `port` tells a serial line from TCP.
        seed: Seed of its noise.
        pace: Rate of its motors' time relative to the host's.
        listen: Host and port at which it listens on TCP; port 0 for a free one.

    Returns:
        The emulated hand, not yet entered.

    Raises:
        ConfigError: The hand has no emulator.
        UserError: It cannot listen there.
    """
    build = find_emulator(config.model)
    if build is None:
        known = ", ".join((*EMULATORS, *installed(_ENTRIES)))
        raise ConfigError(f"no emulator of {config.model!r}: there is one of {known}", code="config.no_emulator")
    return build(config, listen, seed, pace)
