"""The controller's general purpose registers, RTDE watchdogs, and a script's requests to the rest of the controller."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

REGISTERS = 48


class Registers:
    """The registers; RTDE clients write the inputs, the script writes the outputs.

    Attributes:
        bool_in: 128 boolean inputs.
        bool_out: 128 boolean outputs.
        int_in: 48 integer inputs.
        int_out: 48 integer outputs.
        float_in: 48 floating-point inputs.
        float_out: 48 floating-point outputs.
        external_force_torque: Wrench of an external sensor, six values [N, Nm].
    """

    def __init__(self) -> None:
        self.bool_in, self.bool_out = [False] * 128, [False] * 128
        self.int_in, self.int_out = [0] * REGISTERS, [0] * REGISTERS
        self.float_in, self.float_out = [0.0] * REGISTERS, [0.0] * REGISTERS
        self.external_force_torque = [0.0] * 6


class Action(StrEnum):
    """What to do when a variable is not written in time."""

    IGNORE = "ignore"
    PAUSE = "pause"
    STOP = "stop"


@dataclass
class _Watchdog:
    """The watchdog of one variable.

    Attributes:
        patience: Longest time without a write [s].
        action: What to do after it.
        silent: Current time without a write [s].
    """

    patience: float
    action: Action
    silent: float = 0.0


class Watchdogs:
    """The watchdogs of a program, at most one per variable."""

    def __init__(self) -> None:
        self._of: dict[str, _Watchdog] = {}

    def set(self, variable: str, min_frequency: float, action: Action) -> None:
        """Set a watchdog.

        Args:
            variable: Name of the RTDE input variable.
            min_frequency: Minimum frequency of writes [Hz].
            action: What to do when it is not met.
        """
        self._of[variable] = _Watchdog(1.0 / min_frequency, action)

    def feed(self, variable: str) -> None:
        """Record a write to a variable."""
        if variable in self._of:
            self._of[variable].silent = 0.0

    def clear(self) -> None:
        """Remove all watchdogs."""
        self._of.clear()

    def step(self, dt: float) -> tuple[str, Action] | None:
        """Advance by dt [s]; returns a variable that was not written in time and its action, once, or None."""
        for variable, dog in self._of.items():
            before = dog.silent
            dog.silent += dt
            if before <= dog.patience < dog.silent and dog.action is not Action.IGNORE:
                return variable, dog.action
        return None


class EventKind(StrEnum):
    """Kinds of requests."""

    TEXT = "text"
    POPUP = "popup"
    PROTECTIVE_STOP = "protective_stop"
    HALT = "halt"
    PAUSE = "pause"
    STOP = "stop"


@dataclass(frozen=True)
class Event:
    """A request of the script.

    Attributes:
        kind: What is requested.
        text: Text or reason.
    """

    kind: EventKind
    text: str = ""
