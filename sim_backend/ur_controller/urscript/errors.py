"""Errors of scripts."""

from __future__ import annotations

from toolee_robot.errors import TooleeError


class ScriptError(TooleeError):
    """A script does not parse, or failed while it ran.

    Args:
        message: What happened.
        line: Line of the script, 1-based; 0 if unknown.

    Attributes:
        line: Line of the script, 1-based; 0 if unknown.
    """

    def __init__(self, message: str, line: int = 0) -> None:
        super().__init__(f"line {line}: {message}" if line else message)
        self.line = line
