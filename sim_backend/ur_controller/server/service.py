"""The interface of services in the controller's tick loop: ports, the fault port, a simulated world's service."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Service(Protocol):
    """File descriptors that the loop waits on, and callbacks, which must not block."""

    def filenos(self) -> Sequence[int]:
        """Descriptors to wait on for reading."""

    def on_readable(self, fd: int) -> None:
        """Called when a descriptor of `filenos()` is readable."""

    def on_tick(self, dt: float) -> None:
        """Called after each tick of dt [s], with physics and safety up to date."""

    def close(self) -> None:
        """Called when the controller ends."""
