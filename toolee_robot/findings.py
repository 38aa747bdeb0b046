"""The result of a check: one line for a person, with its remedy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from toolee_robot.errors import TooleeError


class Level(StrEnum):
    """Severity of a finding.

    FAIL: nothing may move. WARN: usable, but with reduced quality or reliability. OK: as required.
    """

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes:
        level: Severity.
        name: Name of what was checked, unique in a report.
        message: What was found, with values and units.
        remedy: What to do about it; empty where nothing needs to be done.
    """

    level: Level
    name: str
    message: str
    remedy: str = ""

    @classmethod
    def of_error(cls, name: str, error: TooleeError, remedy: str) -> Finding:
        """Make a FAIL finding from an error.

        Args:
            name: Name of what was checked.
            error: The error; what follows the last colon of its message is the remedy.
            remedy: The remedy where the message has no colon.

        Returns:
            The finding.
        """
        message, colon, from_error = str(error).rpartition(": ")
        return cls(Level.FAIL, name, message, from_error) if colon else cls(Level.FAIL, name, str(error), remedy)

    def __str__(self) -> str:
        return f"{self.name}: {self.message}" + (f": {self.remedy}" if self.remedy else "")


def worst(findings: Iterable[Finding]) -> Level:
    """Return the most severe level; OK without findings."""
    levels = {f.level for f in findings}
    return next((level for level in (Level.FAIL, Level.WARN) if level in levels), Level.OK)


def ok(name: str, message: str) -> Finding:
    """Make an OK finding.

    Args:
        name: Name of what was checked.
        message: What was found.

    Returns:
        The finding, without a remedy.
    """
    return Finding(Level.OK, name, message)


def warn(name: str, message: str, remedy: str) -> Finding:
    """Make a WARN finding.

    Args:
        name: Name of what was checked.
        message: What was found.
        remedy: What to do about it.

    Returns:
        The finding.
    """
    return Finding(Level.WARN, name, message, remedy)


def fail(name: str, message: str, remedy: str) -> Finding:
    """Make a FAIL finding.

    Args:
        name: Name of what was checked.
        message: What was found.
        remedy: What to do about it.

    Returns:
        The finding.
    """
    return Finding(Level.FAIL, name, message, remedy)
