"""What a record's source says of its fields: the one text for the documents and the interview of `toolee station`."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Mapping
from typing import Any

_KNOWN: dict[type[Any], Mapping[str, str]] = {}
"""To parse a source takes milliseconds, and an interview asks hundreds of times."""


def field_docs(record: type[Any]) -> Mapping[str, str]:
    """Description of each field of a dataclass that has one: the docstring after it.

    Args:
        record: The dataclass.

    Returns:
        The descriptions by the fields' names, each on one line.
    """
    if record in _KNOWN:
        return _KNOWN[record]
    body = ast.parse(textwrap.dedent(inspect.getsource(record))).body[0]
    assert isinstance(body, ast.ClassDef)
    docs: dict[str, str] = {}
    for statement, following in zip(body.body, [*body.body[1:], None], strict=True):
        if not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)):
            continue
        if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
            docs[statement.target.id] = " ".join(str(following.value.value).split())
    return _KNOWN.setdefault(record, docs)
