"""A running program: its threads, stepped once per tick of the controller."""

from __future__ import annotations

from collections.abc import Generator
from types import TracebackType
from typing import Any

from toolee_robot.errors import TooleeError
from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.robot.registers import Action, Event, EventKind
from toolee_robot.sim_backend.ur_controller.urscript.compiler import FILE, MAIN
from toolee_robot.sim_backend.ur_controller.urscript.compiling import compiled
from toolee_robot.sim_backend.ur_controller.urscript.expressions import HELPERS
from toolee_robot.sim_backend.ur_controller.urscript.functions.library import LIBRARY
from toolee_robot.sim_backend.ur_controller.urscript.functions.robot import RobotFunctions, function_names
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
