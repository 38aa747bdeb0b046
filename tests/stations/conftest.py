"""What a command has said."""

from __future__ import annotations

from collections.abc import Callable

import pytest


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Callable[[], str]:
    """All that was printed since the last call, in one line."""

    def take() -> str:
        captured = capsys.readouterr()
        return " ".join((captured.out + captured.err).split())

    return take
