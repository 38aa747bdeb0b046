"""URScript's expressions as nodes of Python's syntax tree."""

from __future__ import annotations

import ast
import inspect
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from toolee_robot.sim_backend.ur_controller.urscript import functions_library, syntax
from toolee_robot.sim_backend.ur_controller.urscript.tokens import ScriptError

_Node = TypeVar("_Node", bound=ast.AST)


def at(node: _Node, line: int) -> _Node:
    """Set the line of a node.

    Args:
        node: The node, changed in place.
        line: Line of the script.

    Returns:
        The node.
    """
    node.lineno = node.end_lineno = line  # type: ignore[attr-defined]
    node.col_offset = node.end_col_offset = 0  # type: ignore[attr-defined]
    return node


def load(name: str) -> ast.Name:
    """The value of a variable."""
    return ast.Name(name, ast.Load())


def call(function: str, *arguments: ast.expr) -> ast.Call:
    """A call of a function.

    Args:
        function: Name of the function.
        *arguments: Its positional arguments.

    Returns:
        The call.
    """
    return ast.Call(load(function), list(arguments), [])


def assign(name: str, value: ast.expr) -> ast.Assign:
    """An assignment.

    Args:
        name: Name of the variable.
        value: The value.

    Returns:
        The assignment.
    """
    return ast.Assign([ast.Name(name, ast.Store())], value)


_ARITHMETIC = {"+": "add", "-": "sub", "*": "mul", "/": "truediv", "%": "mod"}
"""Names in `operator`."""
_COMPARE: dict[str, type[ast.cmpop]] = {
    "==": ast.Eq,
    "!=": ast.NotEq,
    "<": ast.Lt,
    "<=": ast.LtE,
    ">": ast.Gt,
    ">=": ast.GtE,
}
_CHECKED = (
    functions_library.negate,
    functions_library.truth,
    functions_library.item,
    functions_library.set_item,
    functions_library.pose,
    functions_library.copied,
    functions_library.flat,
)
HELPERS: dict[str, Callable[..., Any]] = {
    **{f"_{name}": functions_library.of_numbers(getattr(operator, name)) for name in _ARITHMETIC.values()},
    **{f"_{f.__name__}": f for f in _CHECKED},
}
"""Functions that compiled programs call."""


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
        """Describe a function.

        Args:
            function: The function.
            method: Whether its first parameter is the object that it belongs to.

        Returns:
            The description, without that parameter.
        """
        signature = inspect.signature(function)
        if method:
            signature = signature.replace(parameters=list(signature.parameters.values())[1:])
        return cls(signature, inspect.isgeneratorfunction(function))


class ExpressionCompiler:
    """Compiles the expressions of a program, given the names that are local to the present function.

    Args:
        program: The program.
        builtins: The built-in functions, by name.

    Raises:
        ScriptError: A secondary program calls a function that waits.
    """

    def __init__(self, program: syntax.Program, builtins: Mapping[str, Builtin]) -> None:
        self._program, self._builtins = program, builtins
        self._all = [program.main, *program.functions.values()]
        self._globals = {
            node.name
            for node in syntax.nodes(tuple(self._all))
            if isinstance(node, syntax.Assign) and node.scope == "global"
        }
        self._waiting = self._find_waiting()
        self._locals: set[str] = set()
        self._assigned: set[str] = set()

    def _find_waiting(self) -> set[str]:
        """Names of the functions that may wait, of the script and built-in ones."""
        waiting = {name for name, builtin in self._builtins.items() if builtin.waits}
        if self._program.main.kind == "sec":
            for node in syntax.nodes(tuple(self._all)):
                if isinstance(node, syntax.Call) and (node.name in waiting or node.thread):
                    raise ScriptError(f"{node.name}() takes time: not in a secondary program", node.line)
        calls = {name: list(syntax.nodes(function)) for name, function in self._program.functions.items()}
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

    def _variable(self, name: str) -> str:
        return f"l_{name}" if name in self._locals else f"g_{name}"

    def _value(self, e: syntax.Expression) -> ast.expr:
        """An expression to be stored: a list of another variable is copied."""
        value = self._expression(e)
        return call("_copied", value) if isinstance(e, syntax.Name | syntax.Index) else value

    def _element(self, e: syntax.Expression) -> ast.expr:
        value = self._value(e)
        return (
            call("_flat", value) if isinstance(e, syntax.Name | syntax.Index | syntax.ListOf | syntax.Call) else value
        )

    def _condition(self, e: syntax.Expression) -> ast.expr:
        value = self._expression(e)
        known = isinstance(e, syntax.Unary) and e.operator == "not"
        known = known or (isinstance(e, syntax.Binary) and e.operator not in _ARITHMETIC)
        known = known or (isinstance(e, syntax.Literal) and isinstance(e.value, bool))
        return value if known else call("_truth", value)

    def _expression(self, e: syntax.Expression) -> ast.expr:
        return at(self._bare(e), e.line)

    def _bare(self, e: syntax.Expression) -> ast.expr:
        match e:
            case syntax.Literal():
                return ast.Constant(e.value)
            case syntax.Name():
                if e.name not in self._globals and e.name not in self._assigned:
                    raise ScriptError(f"the variable {e.name} is never set", e.line)
                return load(self._variable(e.name))
            case syntax.ListOf():
                if e.pose:
                    return call("_pose", *(self._expression(each) for each in e.items))
                return ast.List([self._element(each) for each in e.items], ast.Load())
            case syntax.Index():
                return call("_item", self._expression(e.base), self._expression(e.index))
            case syntax.Unary(operator="not"):
                return ast.UnaryOp(ast.Not(), self._condition(e.operand))
            case syntax.Unary():
                return call("_negate", self._expression(e.operand))
            case syntax.Binary(operator="and" | "or"):
                joined = ast.And() if e.operator == "and" else ast.Or()
                return ast.BoolOp(joined, [self._condition(e.left), self._condition(e.right)])
            case syntax.Binary(operator="xor"):
                return ast.Compare(self._condition(e.left), [ast.NotEq()], [self._condition(e.right)])
            case syntax.Binary():
                left, right = self._expression(e.left), self._expression(e.right)
                if e.operator in _ARITHMETIC:
                    return call(f"_{_ARITHMETIC[e.operator]}", left, right)
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
            node = call(f"b_{e.name}", *positional)
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
            node = call(f"f_{e.name}", *positional)
        node.keywords = named
        at(node, e.line)
        if e.thread:
            return call("_run", node)
        return ast.YieldFrom(node) if e.name in self._waiting else node


def _bind(called: syntax.Call, signature: inspect.Signature) -> None:
    """Check a call's arguments. Raises ScriptError if they do not fit."""
    names = [name for name, _ in called.named]
    try:
        if len(set(names)) < len(names):
            raise TypeError("an argument is named twice")
        signature.bind(*called.arguments, **dict.fromkeys(names))
    except TypeError as error:
        raise ScriptError(f"{called.name}(): {error}", called.line) from None
