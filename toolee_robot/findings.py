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
    """name: of what was checked, unique in a report. says: what was found, with figures and units. do: what to do about
    it, empty where there is nothing to do."""

    level: Level
    name: str
    says: str
    do: str = ""

    @classmethod
    def of_error(cls, name: str, error: TooleeError, do: str) -> Finding:
        """FAIL, in the error's own words; they end in what to do after a colon, or else `do` says it."""
        says, colon, remedy = str(error).rpartition(": ")
        return cls(Level.FAIL, name, says, remedy) if colon else cls(Level.FAIL, name, str(error), do)

    def __str__(self) -> str:
        return f"{self.name}: {self.says}" + (f": {self.do}" if self.do else "")


def worst(findings: Iterable[Finding]) -> Level:
    """The level that decides; OK for none."""
    levels = {f.level for f in findings}
    return next((level for level in (Level.FAIL, Level.WARN) if level in levels), Level.OK)


def ok(name: str, says: str) -> Finding:
    """As it should be."""
    return Finding(Level.OK, name, says)


def warn(name: str, says: str, do: str) -> Finding:
    """It works, but worse or less surely than it could."""
    return Finding(Level.WARN, name, says, do)


def fail(name: str, says: str, do: str) -> Finding:
    """Nothing may move before it is mended."""
    return Finding(Level.FAIL, name, says, do)
