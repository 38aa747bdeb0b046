"""Syntax tree of a script; lines are counted from 1."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Literal:
    """A number, boolean or string.

    Attributes:
        value: Its value.
        line: Line of the script.
    """

    value: int | float | bool | str
    line: int


@dataclass(frozen=True, slots=True)
class Name:
    """A variable.

    Attributes:
        name: Name of the variable.
        line: Line of the script.
    """

    name: str
    line: int


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list or a pose.

    Attributes:
        items: Elements.
        pose: Whether it is a pose `p[...]`.
        line: Line of the script.
    """

    items: tuple[Expression, ...]
    pose: bool
    line: int


@dataclass(frozen=True, slots=True)
class Index:
    """An element of a list: base[index].

    Attributes:
        base: The list.
        index: The index.
        line: Line of the script.
    """

    base: Expression
    index: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Unary:
    """A unary operation.

    Attributes:
        operator: "-" or "not".
        operand: The operand.
        line: Line of the script.
    """

    operator: str
    operand: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Binary:
    """A binary operation.

    Attributes:
        operator: The operator.
        left: Left operand.
        right: Right operand.
        line: Line of the script.
    """

    operator: str
    left: Expression
    right: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Call:
    """A function call.

    Attributes:
        name: Name of the function.
        arguments: Positional arguments.
        named: Named arguments.
        thread: Whether it starts a thread (`run`).
        line: Line of the script.
    """

    name: str
    arguments: tuple[Expression, ...]
    named: tuple[tuple[str, Expression], ...]
    thread: bool
    line: int


Expression = Literal | Name | ListOf | Index | Unary | Binary | Call


@dataclass(frozen=True, slots=True)
class Assign:
    """An assignment.

    Attributes:
        name: Name of the variable.
        scope: "global", "local", or "" for none, with which a global variable stays global.
        value: The value.
        line: Line of the script.
    """

    name: str
    scope: str
    value: Expression
    line: int


@dataclass(frozen=True, slots=True)
class AssignItem:
    """An assignment to an element: name[i][j]... = value.

    Attributes:
        name: Name of the list.
        indices: Indices.
        value: The value.
        line: Line of the script.
    """

    name: str
    indices: tuple[Expression, ...]
    value: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Evaluate:
    """A call as a statement.

    Attributes:
        call: The call.
        line: Line of the script.
    """

    call: Call
    line: int


@dataclass(frozen=True, slots=True)
class If:
    """A conditional statement.

    Attributes:
        branches: Conditions and blocks of `if` and `elif`.
        otherwise: Block of `else`.
        line: Line of the script.
    """

    branches: tuple[tuple[Expression, Block], ...]
    otherwise: Block
    line: int


@dataclass(frozen=True, slots=True)
class While:
    """A while loop.

    Attributes:
        condition: The condition.
        body: The block.
        line: Line of the script.
    """

    condition: Expression
    body: Block
    line: int


@dataclass(frozen=True, slots=True)
class Return:
    """A return statement.

    Attributes:
        value: The value, or None.
        line: Line of the script.
    """

    value: Expression | None
    line: int


@dataclass(frozen=True, slots=True)
class Keyword:
    """A statement of one keyword.

    Attributes:
        word: "break", "continue", "halt", "enter_critical" or "exit_critical".
        line: Line of the script.
    """

    word: str
    line: int


@dataclass(frozen=True, slots=True)
class Thread:
    """A statement about a thread.

    Attributes:
        word: "kill" or "join".
        thread: The thread.
        line: Line of the script.
    """

    word: str
    thread: Expression
    line: int


Statement = Assign | AssignItem | Evaluate | If | While | Return | Keyword | Thread
Block = tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Function:
    """A function definition.

    Attributes:
        kind: "def", "sec" or "thread".
        name: Name of the function.
        parameters: Names of the parameters.
        defaults: Default values of the last parameters.
        body: Statements.
        line: Line of the script.
    """

    kind: str
    name: str
    parameters: tuple[str, ...]
    defaults: tuple[Expression, ...]
    body: Block
    line: int


@dataclass(slots=True)
class Program:
    """A program.

    Attributes:
        main: The function that runs.
        functions: All functions defined anywhere in it, by name.
    """

    main: Function
    functions: dict[str, Function] = field(default_factory=dict)


def nodes(tree: Any) -> Iterator[Any]:
    """All nodes of a syntax tree, in any order."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, tuple):
            waiting.extend(node)
        elif hasattr(node, "line"):
            yield node
            waiting.extend(getattr(node, name) for name in node.__slots__)
