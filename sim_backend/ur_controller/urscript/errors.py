"""What goes wrong with a script."""

from __future__ import annotations

from toolee_robot.errors import TooleeError


class ScriptError(TooleeError):
    """A script does not parse, or failed while it ran. line: where (1-based), 0 when not known."""

    def __init__(self, message: str, line: int = 0) -> None:
        super().__init__(f"line {line}: {message}" if line else message)
        self.line = line
