"""A terminal for the commands that ask a person at one, and networks that many commands share."""

from __future__ import annotations

import os
import pty
import sys
from collections.abc import Iterator
from functools import cache

import pytest

from toolee_robot.perception import ToolPerception


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The other end of a terminal that is the standard input."""
    master, slave = pty.openpty()
    with os.fdopen(slave) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        yield master
    os.close(master)


@pytest.fixture(scope="module")
def networks_once() -> Iterator[None]:
    """The first command loads the networks, which takes longer than all else that it does; the others have them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ToolPerception, "load", staticmethod(cache(ToolPerception.load)))
        yield
