"""Assertions on the project's errors: tests match an error's stable code, not its message."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import pytest

from toolee_robot.errors import TooleeError

E = TypeVar("E", bound=TooleeError)


class Raised(Generic[E]):
    """The error that a `raises` block caught."""

    value: E


@contextmanager
def raises(kind: type[E], code: str) -> Iterator[Raised[E]]:
    """Expect an error of a class and with exactly this code."""
    raised: Raised[E] = Raised()
    with pytest.raises(kind) as info:
        yield raised
    raised.value = info.value
    assert info.value.code == code, f"code {info.value.code!r}, expected {code!r}; the error is: {info.value}"
