"""Assertions on the project's errors: by their stable code, or by words of their message if they have no own code."""

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
def raises(kind: type[E], code: str | None = None, *, says: str = "") -> Iterator[Raised[E]]:
    """Expect an error of exactly this class and code (the class's own by default), whose message has these words."""
    raised: Raised[E] = Raised()
    with pytest.raises(kind) as info:
        yield raised
    raised.value = info.value
    wanted = kind.code if code is None else code
    assert info.value.code == wanted, f"code {info.value.code!r}, expected {wanted!r}; the error is: {info.value}"
    assert says in str(info.value), f"no word of {says!r}; the error is: {info.value}"
