"""The one program that a controller runs, and the small ones (`sec`) beside it: upload, start, pause, stop."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import IntEnum

from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.urscript import Compiling, ScriptError, ScriptRuntime

WAITING = 20
"""So many uploads may wait for their compiling."""


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
        self._uploaded: deque[Compiling] = deque()
        self._starting: tuple[float, ScriptRuntime] | None = None  # still to wait [s], what then

    @property
    def name(self) -> str:
        return self._main.name if self._main is not None else ""

    @property
    def starting(self) -> bool:
        """A program has come and waits for its start."""
        return bool(self._uploaded) or self._starting is not None

    def upload(self, source: str) -> None:
        """A program as it came over a script port. A `def` ends the running program and takes its place; a `sec` runs
        beside it. One that does not parse, or that may not run now, is dropped with a message, as a controller does. A
        long one is compiled first, while the ticks and the running program go on."""
        self.uploads += 1
        if reason := self._forbidden():
            self._fail(f"script not started: {reason}")
            return
        if self.rejections > 0:
            self.rejections -= 1
            self._fail("script rejected (fault)")
            return
        if len(self._uploaded) >= WAITING:
            self._fail(f"script not started: {WAITING} others are waiting")
            return
        self._uploaded.append(Compiling(source, self._machine.model.e_series))
        self._take_compiled()

    def _take_compiled(self) -> None:
        """In the order in which they came."""
        while self._uploaded and self._uploaded[0].done():
            source, error = self._uploaded[0].source, self._uploaded[0].error
            self._uploaded.popleft()
            try:
                if error is not None:
                    raise error
                runtime = ScriptRuntime(source, self._machine)
            except ScriptError as failure:
                self._fail(f"script not started: {failure}")
                continue
            if runtime.secondary:
                self._secondary.append(runtime)
            else:
                self._end()
                self._starting = (self.start_delay, runtime)

    def stop(self) -> None:
        """End what runs or waits; a moving arm decelerates."""
        for waiting in self._uploaded:
            waiting.cancel()
        self._uploaded.clear()
        self._end()

    def _end(self) -> None:
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
        self._take_compiled()
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
