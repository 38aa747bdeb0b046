"""Nodes of Python's syntax tree that the compiler builds."""

from __future__ import annotations

import ast
from typing import TypeVar

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
