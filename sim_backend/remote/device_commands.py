"""Device commands that take time, in a world whose time is advanced by a controller's tick loop.

A simulated hand or person blocks: it commands, waits, reads, and commands again. Nothing may block the tick loop, so
each command runs in a greenlet: where it waits it is suspended, and it is resumed, within a tick, at the step at which
its wait is over.
"""

from __future__ import annotations

from collections.abc import Callable

from greenlet import getcurrent, greenlet

from toolee_robot.errors import DeviceError
from toolee_robot.sim_backend.world import SimWorld


class Commands:
    """The running commands of a world, at most one per device. All calls must come from the world's thread.

    Args:
        world: The simulated world.
    """

    def __init__(self, world: SimWorld) -> None:
        self._world = world
        self._hub = getcurrent()
        self._running: dict[str, greenlet] = {}
        self._due: dict[greenlet, float] = {}
        world.wait = self._wait
        world.after_step.append(self._wake)

    def start(self, device: str, call: Callable[[], None]) -> None:
        """Start a command; returns when it has finished or first waits.

        Args:
            device: Name of the device.
            call: The command, which must not raise.

        Raises:
            DeviceError: The device still executes another command.
        """
        if device in self._running:
            message = f"the {device} still executes another command: wait for it, or stop the {device}"
            raise DeviceError(message, code="device.busy")

        def run() -> None:
            try:
                call()
            finally:
                self._running.pop(device, None)

        command = self._running[device] = greenlet(run, self._hub)
        command.switch()

    def cancel(self, device: str, reason: str) -> None:
        """Cancel a device's command: its wait raises DeviceError with this reason.

        Args:
            device: Name of the device.
            reason: Message of the error.
        """
        command = self._running.get(device)
        if command is not None:
            self._due.pop(command, None)
            command.throw(DeviceError(reason, code="device.cancelled"))

    def _wait(self, duration: float) -> None:
        command = getcurrent()
        if command not in self._running.values():
            raise RuntimeError("the controller's loop advances the time: nothing else may wait in it")
        self._due[command] = self._world.time + duration
        self._hub.switch()

    def _wake(self) -> None:
        if not self._due:
            return
        now = self._world.time + 1e-9
        for command in [c for c, due in self._due.items() if due <= now]:
            del self._due[command]
            command.switch()
