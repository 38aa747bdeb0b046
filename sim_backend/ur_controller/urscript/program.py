"""The program that a controller runs, and secondary programs (`sec`) beside it: upload, start, pause, stop."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import IntEnum

from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.urscript.compiling import Compiling
from toolee_robot.sim_backend.ur_controller.urscript.runtime import ScriptRuntime
from toolee_robot.sim_backend.ur_controller.urscript.tokens import ScriptError

WAITING = 20
"""Largest number of uploads that wait to be compiled."""


class RuntimeState(IntEnum):
    """RTDE's runtime_state; the stand-in passes the transitional states within a tick."""

    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


class Program:
    """The programs of a controller.

    Args:
        machine: The robot.
        forbidden: Returns why no program may run; empty if one may.
        log: Called with each line of the log.

    Attributes:
        state: Runtime state.
        start_delay: Delay from the upload to the first line [s]; a fault.
        rejections: Number of uploads to discard as if they did not parse; a fault.
        uploads: Number of uploads so far.
        last_error: Message of the last failure.
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
        self._starting: tuple[float, ScriptRuntime] | None = None  # remaining delay [s], program

    @property
    def name(self) -> str:
        """Name of the running program; empty if none runs."""
        return self._main.name if self._main is not None else ""

    @property
    def starting(self) -> bool:
        """Whether an uploaded program waits to start."""
        return bool(self._uploaded) or self._starting is not None

    def upload(self, source: str) -> None:
        """Upload a program.

        A `def` replaces the running program; a `sec` runs beside it. As on a real controller, a program that does not
        parse or may not run is discarded with a message. A long program is compiled in the background.

        Args:
            source: Text of the program, as received on a script port.
        """
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
        """Start or discard the compiled uploads, in their order."""
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
        """End all running and waiting programs; a moving arm decelerates."""
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
        """Pause the program; returns whether one was playing."""
        if self.state is not RuntimeState.PLAYING:
            return False
        self._machine.paused = True
        self._enter(RuntimeState.PAUSED)
        return True

    def resume(self) -> bool:
        """Resume a paused program; returns whether that was possible."""
        if self.state is not RuntimeState.PAUSED or self._forbidden():
            return False
        self._machine.resume()
        self._enter(RuntimeState.PLAYING)
        return True

    def step(self, dt: float) -> None:
        """Execute one tick of dt [s]: start programs that are due, run the threads of those that are playing."""
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
