"""A script as a tree."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Literal:
    value: int | float | bool | str
    line: int


@dataclass(frozen=True, slots=True)
class Name:
    name: str
    line: int


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list, or with `pose` the six numbers of `p[...]`."""

    items: tuple[Expression, ...]
    pose: bool
    line: int


@dataclass(frozen=True, slots=True)
class Index:
    base: Expression
    index: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Unary:
    """operator: "-" or "not"."""

    operator: str
    operand: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Binary:
    operator: str
    left: Expression
    right: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Call:
    """thread: `run` stands before it."""

    name: str
    arguments: tuple[Expression, ...]
    named: tuple[tuple[str, Expression], ...]
    thread: bool
    line: int


Expression = Literal | Name | ListOf | Index | Unary | Binary | Call


@dataclass(frozen=True, slots=True)
class Assign:
    """scope: "global", "local" or "" (what is global keeps being global)."""

    name: str
    scope: str
    value: Expression
    line: int


@dataclass(frozen=True, slots=True)
class AssignItem:
    """name[i][j]... = value."""

    name: str
    indices: tuple[Expression, ...]
    value: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Evaluate:
    """A call for its effect."""

    call: Call
    line: int


@dataclass(frozen=True, slots=True)
class If:
    branches: tuple[tuple[Expression, Block], ...]
    otherwise: Block
    line: int


@dataclass(frozen=True, slots=True)
class While:
    condition: Expression
    body: Block
    line: int


@dataclass(frozen=True, slots=True)
class Return:
    value: Expression | None
    line: int


@dataclass(frozen=True, slots=True)
class Keyword:
    """break, continue, halt, enter_critical or exit_critical."""

    word: str
    line: int


@dataclass(frozen=True, slots=True)
class Thread:
    """kill or join: what is done with a running thread."""

    word: str
    thread: Expression
    line: int


Statement = Assign | AssignItem | Evaluate | If | While | Return | Keyword | Thread
Block = tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Function:
    """kind: "def", "sec" or "thread". defaults: of the last parameters."""

    kind: str
    name: str
    parameters: tuple[str, ...]
    defaults: tuple[Expression, ...]
    body: Block
    line: int


@dataclass(slots=True)
class Program:
    """main: what runs. functions: all that are defined anywhere in it, by name."""

    main: Function
    functions: dict[str, Function] = field(default_factory=dict)
