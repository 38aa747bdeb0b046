"""Device commands that take time, in a world whose time something else lets go on.

A simulated hand or person is written as one who waits: command, let time pass, look, command again. On a controller's
tick loop nobody may wait, so each command runs in a greenlet: where it lets time pass it is put aside, and taken up
again, in the middle of a tick, at the very step at which its time has come.
"""

from __future__ import annotations

from collections.abc import Callable

from greenlet import getcurrent, greenlet

from toolee_robot.errors import DeviceError
from toolee_robot.sim_backend.world import SimWorld


class Commands:
    """The commands under way on a world, at most one a device. All calls from the thread that runs the world."""

    def __init__(self, world: SimWorld) -> None:
        self._world = world
        self._hub = getcurrent()
        self._running: dict[str, greenlet] = {}
        self._due: dict[greenlet, float] = {}
        world.wait = self._wait
        world.after_step.append(self._wake)

    def start(self, device: str, call: Callable[[], None]) -> None:
        """Run `call`, which must not raise, until it is done or first lets time pass. Raises DeviceError when the
        device still carries out another command."""
        if device in self._running:
            raise DeviceError(f"the {device} still carries out another command: wait for it, or stop the {device}")

        def run() -> None:
            try:
                call()
            finally:
                self._running.pop(device, None)

        command = self._running[device] = greenlet(run, self._hub)
        command.switch()

    def cancel(self, device: str, reason: str) -> None:
        """End the device's command where it waits: it raises DeviceError with this reason."""
        command = self._running.get(device)
        if command is not None:
            self._due.pop(command, None)
            command.throw(DeviceError(reason))

    def _wait(self, duration: float) -> None:
        command = getcurrent()
        if command not in self._running.values():
            raise RuntimeError("the controller's loop lets the time go on: nothing else may wait in it")
        self._due[command] = self._world.time + duration
        self._hub.switch()

    def _wake(self) -> None:
        if not self._due:
            return
        now = self._world.time + 1e-9
        for command in [c for c, due in self._due.items() if due <= now]:
            del self._due[command]
            command.switch()
