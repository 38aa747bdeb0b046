"""Ask, all through a motion, whether it may go on; stop the arm when it may not."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

PERIOD = 0.01
"""[s] between two questions: well under the arm's own braking time."""


class Watcher:
    """Inside this context a thread asks `reason_to_stop` every `period` [s] and calls `stop` once it has an answer, and
    again until the context is left: a stop that comes before the arm has begun to move is lost.

    reason_to_stop: a reason in words, empty while the motion may go on; one that raises is a reason, reported after
    `unsure`. reason: the first one."""

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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        except Exception as error:  # noqa: BLE001 - whatever it is, nobody knows any more whether it is safe
            return f"{self._unsure}: {error}"
