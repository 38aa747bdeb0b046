"""What a check found: one line for a person, with what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from toolee_robot.errors import TooleeError


class Level(StrEnum):
    """FAIL: do not move. WARN: it works, but worse or less surely than it could. OK: as it should be."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class Finding:
    """name: of what was checked, unique in a report. message: what was found, with figures and units. remedy: what to
    do about it, empty where there is nothing to do."""

    level: Level
    name: str
    message: str
    remedy: str = ""

    @classmethod
    def of_error(cls, name: str, error: TooleeError, remedy: str) -> Finding:
        """FAIL, in the error's own words; they end in what to do after a colon, or else `remedy` says it."""
        message, colon, from_error = str(error).rpartition(": ")
        return cls(Level.FAIL, name, message, from_error) if colon else cls(Level.FAIL, name, str(error), remedy)

    def __str__(self) -> str:
        return f"{self.name}: {self.message}" + (f": {self.remedy}" if self.remedy else "")


def worst(findings: Iterable[Finding]) -> Level:
    """The level that decides; OK for none."""
    levels = {f.level for f in findings}
    return next((level for level in (Level.FAIL, Level.WARN) if level in levels), Level.OK)


def ok(name: str, message: str) -> Finding:
    """As it should be."""
    return Finding(Level.OK, name, message)


def warn(name: str, message: str, remedy: str) -> Finding:
    """It works, but worse or less surely than it could."""
    return Finding(Level.WARN, name, message, remedy)


def fail(name: str, message: str, remedy: str) -> Finding:
    """Nothing may move before it is mended."""
    return Finding(Level.FAIL, name, message, remedy)
