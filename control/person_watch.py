"""Ask, all through a motion, whether it may go on; stop the arm when it may not."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

PERIOD = 0.01
"""[s] between two questions: well under the arm's own braking time."""


class PersonWatch:
    """Inside this context a thread asks `why_not` every PERIOD and calls `stop` once it has an answer.

    why_not: a reason in words, empty while the motion may go on; one that raises is a reason. `reason`: the first one.
    """

    def __init__(self, why_not: Callable[[], str], stop: Callable[[], None]) -> None:
        self.reason = ""
        self._why_not, self._stop = why_not, stop
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="person watch", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(PERIOD):
            try:
                self.reason = self._why_not()
            except Exception as error:  # noqa: BLE001 - whatever it is, nobody knows any more whether it is safe
                self.reason = f"the station cannot tell whether a person is near: {error}"
            if self.reason:
                self._stop()
                return
