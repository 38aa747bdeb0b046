"""What can be hooked into the controller's tick loop: ports, the fault port, a simulated world's own service."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Service(Protocol):
    """File descriptors that the loop waits on, and a callback in every tick. Neither callback may block."""

    def filenos(self) -> Sequence[int]:
        """Descriptors to wait on for reading, now."""
        ...

    def on_readable(self, fd: int) -> None:
        """One of `filenos()` can be read."""

    def on_tick(self, dt: float) -> None:
        """A tick of dt [s] has been done: physics and safety are up to date."""

    def close(self) -> None:
        """The controller ends."""
