"""Compiler of URScript to Python's `ast`, in a child process, since a long program takes half a second.

The child has the controller's priority, so that other load on the machine does not delay it; it needs a second
processor.
"""

from __future__ import annotations

import ast
import marshal
import os
import signal
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from types import CodeType

from toolee_robot.sim_backend.ur_controller.urscript import syntax
from toolee_robot.sim_backend.ur_controller.urscript.expressions import (
    Builtin,
    ExpressionCompiler,
    assign,
    at,
    call,
    load,
)
from toolee_robot.sim_backend.ur_controller.urscript.functions_library import LIBRARY
from toolee_robot.sim_backend.ur_controller.urscript.functions_robot import RobotFunctions, function_names
from toolee_robot.sim_backend.ur_controller.urscript.parser import parse
from toolee_robot.sim_backend.ur_controller.urscript.tokens import ScriptError

FILE = "<urscript>"
MAIN = "_program"


@dataclass(frozen=True)
class Compiled:
    """A compiled program.

    Attributes:
        code: Code that defines the generator function `MAIN`. Its globals must contain `HELPERS`, the built-in
            functions as `b_...`, and the scheduler's `_budget`, `_run`, `_kill`, `_join`, `_critical` and `_halt`.
        name: Name of the program.
        secondary: Whether it is a `sec`.
    """

    code: CodeType
    name: str
    secondary: bool


def compile_script(source: str, builtins: Mapping[str, Builtin]) -> Compiled:
    """Compile a program.

    Args:
        source: Text of the program.
        builtins: The built-in functions, by name.

    Returns:
        The compiled program.

    Raises:
        ScriptError: It does not parse, or calls a function that does not exist.
    """
    program = parse(source)
    try:
        module = _Compiler(program, builtins).module()
        code = compile(ast.fix_missing_locations(module), FILE, "exec")
    except (RecursionError, SyntaxError, ValueError, MemoryError) as error:
        raise ScriptError(f"too long or nested too deeply ({error})", program.main.line) from None
    return Compiled(code, program.main.name, program.main.kind == "sec")


class _Compiler(ExpressionCompiler):
    """Compiles functions and statements."""

    def module(self) -> ast.Module:
        """The program as a module that defines its functions and `MAIN`."""
        body = [self._function(f"f_{f.name}", f, f.name in self._waiting) for f in self._program.functions.values()]
        body.append(self._function(MAIN, self._program.main, True))
        return ast.Module(body=body, type_ignores=[])

    def _function(self, python_name: str, f: syntax.Function, waits: bool) -> ast.stmt:
        nodes = list(syntax.nodes(f.body))
        declared = {n.name for n in nodes if isinstance(n, syntax.Assign) and n.scope == "local"} | set(f.parameters)
        written = {n.name for n in nodes if isinstance(n, syntax.Assign | syntax.AssignItem)}
        changed = {n.name for n in nodes if isinstance(n, syntax.AssignItem)}
        self._locals = declared | (written - self._globals)
        self._assigned = declared | {n.name for n in nodes if isinstance(n, syntax.Assign)}
        body: list[ast.stmt] = []
        shared = sorted(written & self._globals - declared)
        if shared:
            body.append(ast.Global(names=[f"g_{name}" for name in shared]))
        body.append(ast.Expr(call("_budget")))
        for name in f.parameters:
            if name in changed:
                body.append(assign(f"l_{name}", call("_copied", load(f"l_{name}"))))
        body.extend(self._block(f.body))
        if waits or f.kind == "thread":
            body.append(ast.If(test=ast.Constant(False), body=[ast.Expr(ast.Yield(None))], orelse=[]))
        arguments = ast.arguments(
            posonlyargs=[],
            args=[ast.arg(f"l_{name}") for name in f.parameters],
            kwonlyargs=[],
            kw_defaults=[],
            defaults=[self._constant(default) for default in f.defaults],
        )
        return at(ast.FunctionDef(name=python_name, args=arguments, body=body, decorator_list=[]), f.line)

    def _constant(self, default: syntax.Expression) -> ast.expr:
        if any(isinstance(node, syntax.Name | syntax.Call) for node in syntax.nodes(default)):
            raise ScriptError("a parameter's default has to be a constant", default.line)
        return self._expression(default)

    def _block(self, block: syntax.Block) -> list[ast.stmt]:
        return [at(self._statement(statement), statement.line) for statement in block]

    def _statement(self, s: syntax.Statement) -> ast.stmt:
        match s:
            case syntax.Assign():
                return assign(self._variable(s.name), self._value(s.value))
            case syntax.AssignItem():
                if s.name not in self._globals and s.name not in self._assigned:
                    raise ScriptError(f"the variable {s.name} is never set", s.line)
                target: ast.expr = load(self._variable(s.name))
                for index in s.indices[:-1]:
                    target = call("_item", target, self._expression(index))
                return ast.Expr(call("_set_item", target, self._expression(s.indices[-1]), self._value(s.value)))
            case syntax.Evaluate():
                return ast.Expr(self._expression(s.call))
            case syntax.If():
                otherwise = self._block(s.otherwise)
                for condition, body in reversed(s.branches):
                    test = self._condition(condition)
                    otherwise = [
                        at(ast.If(test=test, body=self._block(body) or [ast.Pass()], orelse=otherwise), condition.line)
                    ]
                return otherwise[0]
            case syntax.While():
                self._loops += 1
                step: list[ast.stmt] = [at(ast.Expr(call("_budget")), s.line)]
                body_of_loop = step + self._block(s.body)
                self._loops -= 1
                return ast.While(test=self._condition(s.condition), body=body_of_loop, orelse=[])
            case syntax.Return():
                return ast.Return(None if s.value is None else self._value(s.value))
            case syntax.Thread(word="kill"):
                return ast.Expr(call("_kill", self._expression(s.thread)))
            case syntax.Thread():
                return ast.Expr(ast.YieldFrom(call("_join", self._expression(s.thread))))
            case syntax.Keyword(word="break" | "continue"):
                if not self._loops:
                    raise ScriptError(f"{s.word} outside of a loop", s.line)
                return ast.Break() if s.word == "break" else ast.Continue()
            case syntax.Keyword(word="halt"):
                return ast.Expr(call("_halt"))
            case syntax.Keyword():
                return ast.Expr(call("_critical", ast.Constant(s.word == "enter_critical")))

    _loops = 0


SHORT = 512
"""[characters] Length up to which compiling takes no longer than starting a child."""
KEPT = 16
"""Size of the cache of compiled programs; clients upload the same one repeatedly."""
_MAX_FILES = 1 << 16

_kept: dict[tuple[str, bool], Compiled] = {}


def compiled(source: str, e_series: bool) -> Compiled:
    """Compile a program in this process, unless it is in the cache.

    Args:
        source: Text of the program.
        e_series: Whether it is for an e-Series controller.

    Returns:
        The compiled program.

    Raises:
        ScriptError: It does not parse, or calls a function that does not exist.
    """
    if (found := _kept.get((source, e_series))) is None:
        found = compile_script(source, _builtins(e_series))
        _keep(source, e_series, found)
    return found


def _keep(source: str, e_series: bool, found: Compiled) -> None:
    _kept[source, e_series] = found
    if len(_kept) > KEPT:
        del _kept[next(iter(_kept))]


@lru_cache(maxsize=2)
def _builtins(e_series: bool) -> dict[str, Builtin]:
    library = {name: Builtin.of(f) for name, f in LIBRARY.items()}
    robot = {name: Builtin.of(getattr(RobotFunctions, name), method=True) for name in function_names(e_series)}
    return {**library, **robot}


class Compiling:
    """The compilation of one program. Once it is `done`, `compiled` returns or raises at once.

    Use it only in the thread of the ticks; `cancel` one that is not done.

    Args:
        source: Text of the program.
        e_series: Whether it is for an e-Series controller.

    Attributes:
        source: Text of the program.
        error: The program's error, or None.
    """

    def __init__(self, source: str, e_series: bool) -> None:
        self.source, self._e_series = source, e_series
        self.error: ScriptError | None = None
        self._child, self._file = 0, -1

    def done(self) -> bool:
        """Whether the compilation has finished; the first call starts it. Never waits."""
        if self.error is not None or len(self.source) <= SHORT or (self.source, self._e_series) in _kept:
            return True
        if not self._child:
            self._file = os.memfd_create("urscript")
            self._child = os.fork()
            if self._child == 0:
                _compile_into(self._file, self.source, self._e_series)
        if os.waitpid(self._child, os.WNOHANG)[0] == 0:
            return False
        self._child = 0
        answer = os.pread(self._file, os.fstat(self._file).st_size, 0)
        os.close(self._file)
        if not answer:
            self.error = ScriptError("the compiler ran out of memory")
            return True
        good, *rest = marshal.loads(answer)
        if good:
            _keep(self.source, self._e_series, Compiled(*rest))
        else:
            self.error = ScriptError(rest[0])
            self.error.line = rest[1]
        return True

    def cancel(self) -> None:
        """End the child process, if there is one."""
        if self._child:
            with suppress(ProcessLookupError):
                os.kill(self._child, signal.SIGKILL)
            os.waitpid(self._child, 0)
            os.close(self._file)
            self._child = 0


def _compile_into(file: int, source: str, e_series: bool) -> None:
    """Compile in the child process and exit.

    Inherited descriptors are closed, since they would keep the controller's connections open.
    """
    try:
        os.closerange(3, file)
        os.closerange(file + 1, _MAX_FILES)
        try:
            found = compile_script(source, _builtins(e_series))
            os.write(file, marshal.dumps((True, found.code, found.name, found.secondary)))
        except ScriptError as error:
            os.write(file, marshal.dumps((False, str(error), error.line)))
    finally:
        os._exit(0)
