"""Emulated hands: what stands in for a station's hand at the other end of its driver's wire.

with emulated_hand(config.hand) as emulator:
    open_hand(replace(config.hand, port=emulator.port), clock)
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from toolee_robot.errors import ConfigError
from toolee_robot.robots.hands import HAND_FILES
from toolee_robot.runtime.device_plugins import installed, load
from toolee_robot.sim_backend.hands.kit import Address, HandEmulator
from toolee_robot.station import HandConfig

LOOPBACK: Address = ("127.0.0.1", 0)
"""Where an emulated hand on TCP listens if nobody says otherwise."""
Build = Callable[[HandConfig, Address, int, float], HandEmulator[Any]]
"""Builds an emulated hand from the station file's `hand`, where it listens on TCP, seed and pace."""
_ENTRIES = "hand_emulator"
"""Kind of the entry points by which packages bring emulators."""


def find_emulator(model: str) -> Build | None:
    """Look up an emulator: one of a file here, or one that an installed package brings (`hand_emulator.NAME`).

    Args:
        model: The hand's name in the station file.

    Returns:
        What builds it; None where there is none.

    Raises:
        ConfigError: What a package names cannot be imported.
    """
    build: Build | None = None
    if model in HAND_FILES:
        build = import_module(f"{__name__}.{HAND_FILES[model]}").emulate
    elif (entry := installed(_ENTRIES).get(model)) is not None:
        build = load(entry)
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
        known = ", ".join((*HAND_FILES, *installed(_ENTRIES)))
        raise ConfigError(f"no emulator of {config.model!r}: there is one of {known}")
    return build(config, listen, seed, pace)
