"""The one program that a controller runs, and the small ones (`sec`) beside it: upload, start, pause, stop."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

from toolee_robot.sim_backend.ur_controller.machine import Machine
from toolee_robot.sim_backend.ur_controller.urscript import ScriptError, ScriptRuntime


class RuntimeState(IntEnum):
    """As RTDE's `runtime_state` says it; the stand-in passes through the transitions within a tick."""

    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


class Program:
    """What is being executed.

    forbidden: says why no program may run now, empty if one may. start_delay [s]: from the upload to the first line.
    rejections: so many uploads to come are thrown away, as if they did not parse (a fault).
    """

    def __init__(self, machine: Machine, forbidden: Callable[[], str], log: Callable[[str], None]) -> None:
        self.state = RuntimeState.STOPPED
        self.start_delay = 0.0
        self.rejections = 0
        self.uploads = 0
        self.last_error = ""
        self._machine, self._forbidden, self._log = machine, forbidden, log
        self._main: ScriptRuntime | None = None
        self._secondary: list[ScriptRuntime] = []
        self._starting: tuple[float, ScriptRuntime] | None = None  # still to wait [s], what then

    @property
    def name(self) -> str:
        return self._main.name if self._main is not None else ""

    @property
    def starting(self) -> bool:
        """A program has come and waits for its start."""
        return self._starting is not None

    def upload(self, source: str) -> None:
        """A program as it came over a script port. A `def` ends the running program and takes its place; a `sec` runs
        beside it. One that does not parse, or that may not run now, is dropped with a message, as a controller does."""
        self.uploads += 1
        if reason := self._forbidden():
            self._fail(f"script not started: {reason}")
            return
        if self.rejections > 0:
            self.rejections -= 1
            self._fail("script rejected (fault)")
            return
        try:
            runtime = ScriptRuntime(source, self._machine)
        except ScriptError as error:
            self._fail(f"script not started: {error}")
            return
        if source.lstrip().startswith("sec"):
            self._secondary.append(runtime)
            return
        self.stop()
        self._starting = (self.start_delay, runtime)

    def stop(self) -> None:
        """End what runs or waits; a moving arm decelerates."""
        self._starting = None
        running, self._main = self._main, None
        for runtime in (running, *self._secondary):
            if runtime is not None:
                runtime.stop()
        self._secondary.clear()
        self._machine.paused = False
        self._enter(RuntimeState.STOPPED)

    def pause(self) -> bool:
        """Decelerate and wait; returns whether a program was playing."""
        if self.state is not RuntimeState.PLAYING:
            return False
        self._machine.paused = True
        self._enter(RuntimeState.PAUSED)
        return True

    def resume(self) -> bool:
        """Go on after a pause; returns whether that was possible."""
        if self.state is not RuntimeState.PAUSED or self._forbidden():
            return False
        self._machine.paused = False
        self._enter(RuntimeState.PLAYING)
        return True

    def step(self, dt: float) -> None:
        """One tick of dt [s]: start what is due, run every thread of what is playing."""
        if self._starting is not None:
            wait, runtime = self._starting
            if wait <= 0.0:
                self._starting, self._main = None, runtime
                self._enter(RuntimeState.PLAYING)
            else:
                self._starting = (wait - dt, runtime)
        for runtime in self._secondary:
            runtime.step(dt)
        self._secondary = [runtime for runtime in self._secondary if runtime.running]
        if self._main is None or self.state is not RuntimeState.PLAYING:
            return
        self._main.step(dt)
        if not self._main.running:
            if self._main.error is not None:
                self._fail(f"program {self._main.name}: {self._main.error}")
            self._main = None
            self._enter(RuntimeState.STOPPED)

    def _enter(self, state: RuntimeState) -> None:
        if state is not self.state:
            self.state = state
            self._log(f"program {self.name}: {state.name}" if self.name else f"program: {state.name}")

    def _fail(self, message: str) -> None:
        self.last_error = message
        self._log(message)
