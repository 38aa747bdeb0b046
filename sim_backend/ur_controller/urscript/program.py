"""The program that a controller runs, and secondary programs (`sec`) beside it: upload, start, pause, stop, threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from enum import IntEnum
from types import TracebackType
from typing import Any

from toolee_robot.errors import TooleeError
from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.robot.registers import Action, Event, EventKind
from toolee_robot.sim_backend.ur_controller.urscript.compiling import FILE, MAIN, Compiling, compiled
from toolee_robot.sim_backend.ur_controller.urscript.expressions import HELPERS
from toolee_robot.sim_backend.ur_controller.urscript.functions_library import LIBRARY
from toolee_robot.sim_backend.ur_controller.urscript.functions_robot import RobotFunctions, function_names
from toolee_robot.sim_backend.ur_controller.urscript.tokens import ScriptError

BUDGET = 20_000
"""Loop iterations and calls per tick and thread, above which a thread is in an endless loop without `sync()`."""
THREADS = 100
"""Largest number of threads of a program; ended threads count until the end of the tick."""
SCRIPT_FAULTS = (
    ArithmeticError,
    IndexError,
    NameError,
    RecursionError,
    TooleeError,
    TypeError,
    ValueError,
)


class _End(Exception):
    """Raised by `halt`, and by a thread that kills itself."""


class _Thread:
    """A thread of a program: its generator, and whether it has not ended."""

    def __init__(self, generator: Generator[None, None, Any]) -> None:
        self.generator, self.alive = generator, True


class ScriptRuntime:
    """A program on a controller; it starts with the next `step`.

    Threads are scheduled in the order of their start; within a tick each runs until it waits. During a critical section
    only its thread runs. The program ends with its main function.

    Args:
        source: Text of one program (`def name(): ... end`, or `sec`, or bare statements).
        machine: The robot.

    Attributes:
        name: Name of the program.
        secondary: Whether it is a `sec`, which takes no time and does not move the arm.
        error: Error that ended the program, or None.
        running: Whether it has not ended.

    Raises:
        ScriptError: It does not parse, or calls a function that does not exist.
    """

    def __init__(self, source: str, machine: Machine) -> None:
        program = compiled(source, machine.model.e_series)
        self.name, self.secondary = program.name, program.secondary
        self.error: ScriptError | None = None
        self.running = True
        self._machine = machine
        functions = RobotFunctions(machine)
        names: dict[str, Any] = {
            **HELPERS,
            **{f"b_{name}": f for name, f in LIBRARY.items()},
            **{f"b_{name}": getattr(functions, name) for name in function_names(machine.model.e_series)},
            "_budget": self._spend,
            "_run": self._run,
            "_kill": self._kill,
            "_join": self._join,
            "_critical": self._set_critical,
            "_halt": self._halt,
        }
        exec(program.code, names)
        self._main = _Thread(names[MAIN]())
        self._threads = [self._main]
        self._current = self._main
        self._critical: _Thread | None = None
        self._left = BUDGET

    def step(self, dt: float) -> None:
        """Run every thread until it waits.

        On a script error the program ends: `running` becomes False, `error` is set, and the arm decelerates.

        Args:
            dt: Time since the last step [s].
        """
        if not self.running or (not self.secondary and self._silent(dt)):
            return
        at = 0
        while at < len(self._threads):
            thread = self._threads[at]
            at += 1
            if not thread.alive or self._critical not in (None, thread):
                continue
            self._turn(thread)
            if not self._main.alive:
                self.stop()
                return
        self._threads = [thread for thread in self._threads if thread.alive]

    def stop(self) -> None:
        """End the program and its threads; the arm decelerates."""
        if not self.running:
            return
        self.running = False
        for thread in self._threads:
            thread.alive = False
            thread.generator.close()
        if not self.secondary:
            self._machine.end_program()

    def _silent(self, dt: float) -> bool:
        found = self._machine.watchdogs.step(dt)
        if found is None:
            return False
        variable, action = found
        self._machine.events.append(Event(EventKind.TEXT, f"RTDE watchdog: {variable} was not written in time"))
        if action is Action.STOP:
            self.stop()
        else:
            self._machine.events.append(Event(EventKind.PAUSE, variable))
        return True

    def _turn(self, thread: _Thread) -> None:
        self._current, self._left = thread, BUDGET
        try:
            next(thread.generator)
        except (StopIteration, _End):
            thread.alive = False
        except SCRIPT_FAULTS as error:
            thread.alive = self._main.alive = False
            self.error = _described(error)
        if not thread.alive and self._critical is thread:
            self._critical = None

    def _spend(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise RecursionError("an endless loop: no sync() or other waiting function in it")

    def _run(self, generator: Generator[None, None, Any]) -> _Thread:
        if len(self._threads) >= THREADS:
            raise RecursionError(f"more than {THREADS} threads")
        thread = _Thread(generator)
        self._threads.append(thread)
        return thread

    def _kill(self, thread: Any) -> None:
        """End a thread. Other values are ignored: scripts use 0 for "no thread"."""
        if not isinstance(thread, _Thread) or not thread.alive:
            return
        thread.alive = False
        if thread is self._current:
            raise _End
        thread.generator.close()

    def _join(self, thread: Any) -> Generator[None, None, None]:
        while isinstance(thread, _Thread) and thread.alive:
            yield

    def _set_critical(self, on: bool) -> None:
        self._critical = self._current if on else None

    def _halt(self) -> None:
        self._main.alive = False
        self._machine.events.append(Event(EventKind.HALT))
        raise _End


def _described(error: Exception) -> ScriptError:
    """Convert an error to a ScriptError with the script's line from the traceback."""
    line = 0
    trace: TracebackType | None = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == FILE:
            line = trace.tb_lineno
        trace = trace.tb_next
    message = str(error)
    if isinstance(error, NameError):
        name = message.split("'")[1][2:] if "'" in message else "?"
        message = f"the variable {name} has no value yet"
    return ScriptError(message, line)


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
