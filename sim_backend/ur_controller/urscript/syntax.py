"""Syntax tree of a script. `line` of every node is its line in the script, 1-based."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Literal:
    """A number, boolean or string."""

    value: int | float | bool | str
    line: int


@dataclass(frozen=True, slots=True)
class Name:
    """A variable."""

    name: str
    line: int


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list, or with `pose` a pose `p[...]`."""

    items: tuple[Expression, ...]
    pose: bool
    line: int


@dataclass(frozen=True, slots=True)
class Index:
    """An element of a list: base[index]."""

    base: Expression
    index: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Unary:
    """A unary operation; operator: "-" or "not"."""

    operator: str
    operand: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Binary:
    """A binary operation."""

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
    """An assignment; scope: "global", "local", or "" for none, with which a global variable stays global."""

    name: str
    scope: str
    value: Expression
    line: int


@dataclass(frozen=True, slots=True)
class AssignItem:
    """An assignment to an element: name[i][j]... = value."""

    name: str
    indices: tuple[Expression, ...]
    value: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Evaluate:
    """A call as a statement."""

    call: Call
    line: int


@dataclass(frozen=True, slots=True)
class If:
    """if, elif, else: conditions with their blocks, and the block of else."""

    branches: tuple[tuple[Expression, Block], ...]
    otherwise: Block
    line: int


@dataclass(frozen=True, slots=True)
class While:
    """A while loop."""

    condition: Expression
    body: Block
    line: int


@dataclass(frozen=True, slots=True)
class Return:
    """A return statement."""

    value: Expression | None
    line: int


@dataclass(frozen=True, slots=True)
class Keyword:
    """A statement of one keyword: break, continue, halt, enter_critical or exit_critical."""

    word: str
    line: int


@dataclass(frozen=True, slots=True)
class Thread:
    """A kill or join statement."""

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
