"""Poll a stop condition throughout a motion and stop the arm when it holds."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Self

PERIOD = 0.01
"""Polling period [s], well under the arm's braking time."""


class Watcher:
    """Context in which a thread polls a stop condition and stops the arm when it holds.

    The stop is repeated until the context ends, since a stop before the arm has begun to move has no effect.

    Args:
        reason_to_stop: Returns the reason for a stop, empty while the motion may continue; an exception counts as a
            reason.
        stop: Stops the arm; called from the watcher's thread.
        unsure: Prefix of the reason when `reason_to_stop` raises.
        period: Polling period [s].

    Attributes:
        reason: The first reason for a stop; empty if none.
    """

    def __init__(
        self, reason_to_stop: Callable[[], str], stop: Callable[[], None], unsure: str, period: float = PERIOD
    ) -> None:
        self.reason = ""
        self._reason_to_stop, self._stop, self._unsure, self._period = reason_to_stop, stop, unsure, period
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watcher", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(self._period):
            self.reason = self.reason or self._ask()
            if self.reason:
                self._stop()

    def _ask(self) -> str:
        try:
            return self._reason_to_stop()
        except Exception as error:  # noqa: BLE001 - after any error, safety is unknown
            return f"{self._unsure}: {error}"
