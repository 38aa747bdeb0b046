"""Compiler from the syntax tree to Python byte code, through Python's `ast`.

Every function that may wait (`sync`, a motion, ...) becomes a generator that yields once per tick of the controller,
every other one a plain function. Lines of the byte code are lines of the script, so tracebacks contain them. Bindings
are static, as in the URScript manual: `local` names and parameters are local, a name that is declared `global` anywhere
is global, any other name is local to its function; nested functions do not see the locals of the enclosing one.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import CodeType
from typing import Any, TypeVar

from toolee_robot.sim_backend.ur_controller.urscript import syntax, values
from toolee_robot.sim_backend.ur_controller.urscript.errors import ScriptError
from toolee_robot.sim_backend.ur_controller.urscript.parser import parse

_Node = TypeVar("_Node", bound=ast.AST)
FILE = "<urscript>"
MAIN = "_program"
_ARITHMETIC = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide", "%": "modulo"}
_COMPARE: dict[str, type[ast.cmpop]] = {
    "==": ast.Eq,
    "!=": ast.NotEq,
    "<": ast.Lt,
    "<=": ast.LtE,
    ">": ast.Gt,
    ">=": ast.GtE,
}
HELPERS: dict[str, Callable[..., Any]] = {
    f"_{f.__name__}": f
    for f in (
        values.add,
        values.subtract,
        values.multiply,
        values.divide,
        values.modulo,
        values.negate,
        values.truth,
        values.item,
        values.set_item,
        values.pose,
        values.copied,
        values.flat,
    )
}


@dataclass(frozen=True)
class Builtin:
    """A built-in function.

    Attributes:
        signature: Its signature.
        waits: Whether it is a generator function.
    """

    signature: inspect.Signature
    waits: bool

    @classmethod
    def of(cls, function: Callable[..., Any], method: bool = False) -> Builtin:
        """Describe a function; of a `method`, without its first parameter."""
        signature = inspect.signature(function)
        if method:
            signature = signature.replace(parameters=list(signature.parameters.values())[1:])
        return cls(signature, inspect.isgeneratorfunction(function))


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


def _nodes(tree: Any) -> Iterator[Any]:
    """All nodes of a syntax tree, in any order."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, tuple):
            waiting.extend(node)
        elif hasattr(node, "line"):
            yield node
            waiting.extend(getattr(node, name) for name in node.__slots__)


class _Compiler:
    def __init__(self, program: syntax.Program, builtins: Mapping[str, Builtin]) -> None:
        self._program, self._builtins = program, builtins
        self._all = [program.main, *program.functions.values()]
        self._globals = {
            node.name for node in _nodes(tuple(self._all)) if isinstance(node, syntax.Assign) and node.scope == "global"
        }
        self._waiting = self._find_waiting()
        self._locals: set[str] = set()
        self._assigned: set[str] = set()

    def _find_waiting(self) -> set[str]:
        """Names of the functions that may wait, of the script and built-in ones."""
        waiting = {name for name, builtin in self._builtins.items() if builtin.waits}
        if self._program.main.kind == "sec":
            for node in _nodes(tuple(self._all)):
                if isinstance(node, syntax.Call) and (node.name in waiting or node.thread):
                    raise ScriptError(f"{node.name}() takes time: not in a secondary program", node.line)
        calls = {name: list(_nodes(function)) for name, function in self._program.functions.items()}
        while True:
            more = {
                name
                for name, nodes in calls.items()
                if name not in waiting
                and any(
                    (isinstance(node, syntax.Call) and not node.thread and node.name in waiting)
                    or (isinstance(node, syntax.Thread) and node.word == "join")
                    for node in nodes
                )
            }
            if not more:
                return waiting
            waiting |= more

    def module(self) -> ast.Module:
        body = [self._function(f"f_{f.name}", f, f.name in self._waiting) for f in self._program.functions.values()]
        body.append(self._function(MAIN, self._program.main, True))
        return ast.Module(body=body, type_ignores=[])

    def _function(self, python_name: str, f: syntax.Function, waits: bool) -> ast.stmt:
        nodes = list(_nodes(f.body))
        declared = {n.name for n in nodes if isinstance(n, syntax.Assign) and n.scope == "local"} | set(f.parameters)
        written = {n.name for n in nodes if isinstance(n, syntax.Assign | syntax.AssignItem)}
        changed = {n.name for n in nodes if isinstance(n, syntax.AssignItem)}
        self._locals = declared | (written - self._globals)
        self._assigned = declared | {n.name for n in nodes if isinstance(n, syntax.Assign)}
        body: list[ast.stmt] = []
        shared = sorted(written & self._globals - declared)
        if shared:
            body.append(ast.Global(names=[f"g_{name}" for name in shared]))
        body.append(ast.Expr(_call("_budget")))
        for name in f.parameters:
            if name in changed:
                body.append(_assign(f"l_{name}", _call("_copied", _load(f"l_{name}"))))
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
        return _at(ast.FunctionDef(name=python_name, args=arguments, body=body, decorator_list=[]), f.line)

    def _constant(self, default: syntax.Expression) -> ast.expr:
        if any(isinstance(node, syntax.Name | syntax.Call) for node in _nodes(default)):
            raise ScriptError("a parameter's default has to be a constant", default.line)
        return self._expression(default)

    # -- statements

    def _block(self, block: syntax.Block) -> list[ast.stmt]:
        return [_at(self._statement(statement), statement.line) for statement in block]

    def _statement(self, s: syntax.Statement) -> ast.stmt:
        match s:
            case syntax.Assign():
                return _assign(self._variable(s.name), self._value(s.value))
            case syntax.AssignItem():
                if s.name not in self._globals and s.name not in self._assigned:
                    raise ScriptError(f"the variable {s.name} is never set", s.line)
                target: ast.expr = _load(self._variable(s.name))
                for index in s.indices[:-1]:
                    target = _call("_item", target, self._expression(index))
                return ast.Expr(_call("_set_item", target, self._expression(s.indices[-1]), self._value(s.value)))
            case syntax.Evaluate():
                return ast.Expr(self._expression(s.call))
            case syntax.If():
                otherwise = self._block(s.otherwise)
                for condition, body in reversed(s.branches):
                    test = self._condition(condition)
                    otherwise = [
                        _at(ast.If(test=test, body=self._block(body) or [ast.Pass()], orelse=otherwise), condition.line)
                    ]
                return otherwise[0]
            case syntax.While():
                self._loops += 1
                step: list[ast.stmt] = [_at(ast.Expr(_call("_budget")), s.line)]
                body_of_loop = step + self._block(s.body)
                self._loops -= 1
                return ast.While(test=self._condition(s.condition), body=body_of_loop, orelse=[])
            case syntax.Return():
                return ast.Return(None if s.value is None else self._value(s.value))
            case syntax.Thread(word="kill"):
                return ast.Expr(_call("_kill", self._expression(s.thread)))
            case syntax.Thread():
                return ast.Expr(ast.YieldFrom(_call("_join", self._expression(s.thread))))
            case syntax.Keyword(word="break" | "continue"):
                if not self._loops:
                    raise ScriptError(f"{s.word} outside of a loop", s.line)
                return ast.Break() if s.word == "break" else ast.Continue()
            case syntax.Keyword(word="halt"):
                return ast.Expr(_call("_halt"))
            case syntax.Keyword():
                return ast.Expr(_call("_critical", ast.Constant(s.word == "enter_critical")))

    _loops = 0

    # -- expressions

    def _variable(self, name: str) -> str:
        return f"l_{name}" if name in self._locals else f"g_{name}"

    def _value(self, e: syntax.Expression) -> ast.expr:
        """An expression to be stored: a list of another variable is copied."""
        value = self._expression(e)
        return _call("_copied", value) if isinstance(e, syntax.Name | syntax.Index) else value

    def _element(self, e: syntax.Expression) -> ast.expr:
        value = self._value(e)
        return (
            _call("_flat", value) if isinstance(e, syntax.Name | syntax.Index | syntax.ListOf | syntax.Call) else value
        )

    def _condition(self, e: syntax.Expression) -> ast.expr:
        value = self._expression(e)
        known = isinstance(e, syntax.Unary) and e.operator == "not"
        known = known or (isinstance(e, syntax.Binary) and e.operator not in _ARITHMETIC)
        known = known or (isinstance(e, syntax.Literal) and isinstance(e.value, bool))
        return value if known else _call("_truth", value)

    def _expression(self, e: syntax.Expression) -> ast.expr:
        return _at(self._bare(e), e.line)

    def _bare(self, e: syntax.Expression) -> ast.expr:
        match e:
            case syntax.Literal():
                return ast.Constant(e.value)
            case syntax.Name():
                if e.name not in self._globals and e.name not in self._assigned:
                    raise ScriptError(f"the variable {e.name} is never set", e.line)
                return _load(self._variable(e.name))
            case syntax.ListOf():
                if e.pose:
                    return _call("_pose", *(self._expression(each) for each in e.items))
                return ast.List([self._element(each) for each in e.items], ast.Load())
            case syntax.Index():
                return _call("_item", self._expression(e.base), self._expression(e.index))
            case syntax.Unary(operator="not"):
                return ast.UnaryOp(ast.Not(), self._condition(e.operand))
            case syntax.Unary():
                return _call("_negate", self._expression(e.operand))
            case syntax.Binary(operator="and" | "or"):
                operator = ast.And() if e.operator == "and" else ast.Or()
                return ast.BoolOp(operator, [self._condition(e.left), self._condition(e.right)])
            case syntax.Binary(operator="xor"):
                return ast.Compare(self._condition(e.left), [ast.NotEq()], [self._condition(e.right)])
            case syntax.Binary():
                left, right = self._expression(e.left), self._expression(e.right)
                if e.operator in _ARITHMETIC:
                    return _call(f"_{_ARITHMETIC[e.operator]}", left, right)
                return ast.Compare(left, [_COMPARE[e.operator]()], [right])
            case syntax.Call():
                return self._call(e)

    def _call(self, e: syntax.Call) -> ast.expr:
        function = self._program.functions.get(e.name)
        positional = [self._expression(each) for each in e.arguments]
        if function is None:
            if e.thread:
                raise ScriptError(f"there is no thread {e.name}", e.line)
            if e.name not in self._builtins:
                raise ScriptError(f"there is no function {e.name}()", e.line)
            _bind(e, self._builtins[e.name].signature)
            named = [ast.keyword(name, self._expression(value)) for name, value in e.named]
            call: ast.expr = _call(f"b_{e.name}", *positional)
        else:
            if (function.kind == "thread") is not e.thread:
                raise ScriptError(f"{e.name}: `run` starts threads and only threads", e.line)
            required = len(function.parameters) - len(function.defaults)
            _bind(
                e,
                inspect.Signature(
                    [
                        inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD)
                        if i < required
                        else inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=None)
                        for i, name in enumerate(function.parameters)
                    ]
                ),
            )
            named = [ast.keyword(f"l_{name}", self._expression(value)) for name, value in e.named]
            call = _call(f"f_{e.name}", *positional)
        assert isinstance(call, ast.Call)
        call.keywords = named
        _at(call, e.line)
        if e.thread:
            return _call("_run", call)
        return ast.YieldFrom(call) if e.name in self._waiting else call


def _bind(call: syntax.Call, signature: inspect.Signature) -> None:
    """Check a call's arguments. Raises ScriptError if they do not fit."""
    names = [name for name, _ in call.named]
    try:
        if len(set(names)) < len(names):
            raise TypeError("an argument is named twice")
        signature.bind(*call.arguments, **dict.fromkeys(names))
    except TypeError as error:
        raise ScriptError(f"{call.name}(): {error}", call.line) from None


def _at(node: _Node, line: int) -> _Node:
    node.lineno = node.end_lineno = line  # type: ignore[attr-defined]
    node.col_offset = node.end_col_offset = 0  # type: ignore[attr-defined]
    return node


def _load(name: str) -> ast.Name:
    return ast.Name(name, ast.Load())


def _call(function: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(_load(function), list(arguments), [])


def _assign(name: str, value: ast.expr) -> ast.Assign:
    return ast.Assign([ast.Name(name, ast.Store())], value)
