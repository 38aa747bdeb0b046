"""Drivers of what the flange carries, one file a hand, and the one that a station file names.

with open_hand(load_lab_station(Path("lab.yaml")).hand, HostClock()) as hand:
    hand.open()

A file here brings `KIND`, the `WiredHandKind` of the hands whose models are in the file of the same name in
`robots.hands`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator
from dataclasses import dataclass
from importlib import import_module
from typing import Self

import numpy as np

from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, Hand, HandState
from toolee_robot.robots import MOUNT, HandModel, hand_model
from toolee_robot.robots.hands import HAND_FILES
from toolee_robot.runtime.device_plugins import installed, load
from toolee_robot.station import HandConfig
from toolee_robot.types import HandEfforts, JointState

SERIAL = "the serial port, such as /dev/ttyUSB0"
EFFORTS_MAX_AGE_S, EFFORTS_PERIOD_S = 0.5, 0.01
"""Longest time without a reading while efforts are shown, and time between two."""
_ENTRIES = "hand"
"""Kind of the entry points by which packages bring drivers."""


@dataclass(frozen=True)
class WiredHandKind:
    """A kind of hand on a wire: its driver, and where it is found.

    Attributes:
        driver: Builds the driver from model, port, the station file's `hand`, and clock.
        ports: What its port may be, for people.
        scheme: Scheme of its port if that is an address, such as tcp; None for a serial port only.
        serial: Whether its port may be a serial one.
        numbered: Whether it has a number on its line (`hand.hand_id`).
        measured_efforts: Whether a lab must measure what its efforts mean.
    """

    driver: Callable[[HandModel, str, HandConfig, Clock], Hand]
    ports: str
    scheme: str | None = None
    serial: bool = True
    numbered: bool = False
    measured_efforts: bool = False


class MountedTool:
    """A `hal.Hand` that is a tool mount: it has no sensor and no motor, a person opens and closes it.

    Its state is what a person said last, never a measurement: `holding` from `close` to `open`, the hinge at rest. It
    cannot tell that a tool came loose. The looks at the tool, the touches, and strikes that miss do.

    Args:
        model: The mount: `hand_model(config.hand)`.
        clock: Clock of the station.
    """

    def __init__(self, model: HandModel, clock: Clock) -> None:
        self._model, self._clock = model, clock
        self._rest = model.posture("open")
        self._holding = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held by power: the tool stays where it is."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The name of the hinge."""
        return self._model.joints

    def state(self, max_age: float = 0.1) -> HandState:  # noqa: ARG002
        """The state as far as it is known.

        Args:
            max_age: Ignored: nothing is measured.

        Returns:
            The hinge at rest, no forces, and whether a tool is in the mount as a person said last.
        """
        return HandState(JointState(self._rest, np.zeros_like(self._rest), self._clock.now()), {}, self._holding)

    def open(self, timeout: float = 5.0) -> None:  # noqa: ARG002
        """Note that a person has taken the tool out.

        Args:
            timeout: Ignored.
        """
        self._holding = False

    def close(self, timeout: float = 5.0) -> None:  # noqa: ARG002
        """Note that a person has fixed a tool.

        Args:
            timeout: Ignored.
        """
        self._holding = True

    def stop(self) -> None:
        """Do nothing: a mount does not move by itself."""


def wired_hand(model: str) -> WiredHandKind | None:
    """Look up a kind of hand on a wire: one of a file here, or one that an installed package names.

    Args:
        model: Its name in the station file.

    Returns:
        The kind; None where there is none of that name, or its package brings a driver alone.

    Raises:
        ConfigError: What a package names cannot be imported.
    """
    if model in HAND_FILES:
        found = import_module(f"{__name__}.{HAND_FILES[model]}").KIND
    else:
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
        known = ", ".join((*HAND_FILES, *plugins, MOUNT))
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

    Yields:
        Effort of each motor as they come, (20,) [in the hand's unit].

    Raises:
        UserError: The hand's maker says what its forces mean.
        ConfigError: The port is missing, or none of this hand.
    """
    kind = wired_hand(config.model)
    if kind is None or not kind.measured_efforts:
        message = f"{config.model} has no hand.efforts to measure: `toolee hand state` shows its forces in newtons"
        raise UserError(message)
    _check_address(config, kind)
    from toolee_robot.devices.hands.shadow import ShadowHand

    unknown = HandEfforts(touch=1.0, grip=2.0, newtons_per_unit=1.0)  # only a motion needs them
    with ShadowHand(hand_model(config.model), _port(config, kind), unknown, clock) as hand:
        while True:
            yield hand.reading(EFFORTS_MAX_AGE_S).forces
            clock.sleep(EFFORTS_PERIOD_S)


def _port(config: HandConfig, kind: WiredHandKind) -> str:
    if config.port is None:
        message = f"hand.port of the {hand_model(config).label} is missing: {kind.ports}"
        raise ConfigError(message, code="config.hand_port")
    return config.port


def _check_address(config: HandConfig, kind: WiredHandKind) -> None:
    """Refuse a port or a number that a kind of hand cannot have."""
    if config.hand_id is not None and not kind.numbered:
        message = f"hand.hand_id: {config.model} has none, because its port is an address. Remove the field"
        raise ConfigError(message)
    port = config.port
    if port is None:
        return
    scheme = port.partition("://")[0] if "://" in port else None
    if scheme is None and re.fullmatch(r"[\w.-]+:\d+", port) and kind.scheme is not None:
        message = f"hand.port {port!r} is no serial port: write {kind.scheme}://{port}"
        raise ConfigError(message, code="config.hand_port")
    known = kind.serial if scheme is None else scheme == kind.scheme and re.fullmatch(r"\w+://[\w.-]+:\d+", port)
    if not known:
        raise ConfigError(f"hand.port {port!r} is not for {config.model}: give {kind.ports}", code="config.hand_port")


def hand_drivers() -> dict[str, str]:
    """The hands that a station file may name and that have a driver, and where each is from."""
    others = {name: entry.value for name, entry in installed(_ENTRIES).items()}
    return others | dict.fromkeys((*HAND_FILES, MOUNT), "toolee_robot")
