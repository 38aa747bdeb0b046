"""RTDE watchdogs: a script asks that an input variable be written often enough."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Action(StrEnum):
    IGNORE = "ignore"
    PAUSE = "pause"
    STOP = "stop"


@dataclass
class _Watchdog:
    patience: float
    action: Action
    silent: float = 0.0


class Watchdogs:
    """One per variable; they end with the program that set them."""

    def __init__(self) -> None:
        self._of: dict[str, _Watchdog] = {}

    def set(self, variable: str, min_frequency: float, action: Action) -> None:
        """From now on the variable has to be written at least with min_frequency [Hz]."""
        self._of[variable] = _Watchdog(1.0 / min_frequency, action)

    def feed(self, variable: str) -> None:
        if variable in self._of:
            self._of[variable].silent = 0.0

    def clear(self) -> None:
        self._of.clear()

    def step(self, dt: float) -> tuple[str, Action] | None:
        """After dt [s] more: the variable that was silent for too long and what is to be done; reported once."""
        for variable, dog in self._of.items():
            before = dog.silent
            dog.silent += dt
            if before <= dog.patience < dog.silent and dog.action is not Action.IGNORE:
                return variable, dog.action
        return None
