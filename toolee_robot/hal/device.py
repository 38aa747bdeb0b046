"""Protocol of every device, and of the clock."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self, runtime_checkable


class Device(Protocol):
    """A device that is opened, used, and left in a safe state."""

    def __enter__(self) -> Self:
        """Open the device.

        Raises:
            DeviceError: The device does not answer or is not ready.
        """

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Bring the device to a safe standstill and close it."""


@runtime_checkable
class Clock(Protocol):
    """The station's clock; in a simulation only motion and sleep advance it."""

    def now(self) -> float:
        """Return the present time [s]."""

    def sleep(self, duration: float) -> None:
        """Wait for `duration` [s] of the station's time."""
