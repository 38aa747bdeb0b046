"""The runs in a folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from toolee_robot.errors import UserError
from toolee_robot.recording import RECORDING

UNFINISHED = "unfinished"
"""Outcome of a run without a summary: it goes on, or was killed."""


@dataclass(frozen=True)
class Run:
    """A run in its folder.

    Attributes:
        folder: The folder.
        date: When it began, local time.
        source: simulation, rehearsal, lab; empty where unknown.
        seed: Its seed; None for a lab's.
        outcome: How it ended, or `UNFINISHED`.
        success: Whether the nail is flush; None if unfinished.
        strikes: Number of strikes; None if unfinished.
        seconds: Wall-clock time [s]; None if unfinished.
        robot_seconds: Time on the station's clock [s]; None if unfinished.
        megabytes: Size of its files [MB].
    """

    folder: Path
    date: datetime
    source: str
    seed: int | None
    outcome: str
    success: bool | None
    strikes: int | None
    seconds: float | None
    robot_seconds: float | None
    megabytes: float


def list_runs(folder: Path) -> list[Run]:
    """The runs in a folder, the oldest first; what is no run's folder is left out.

    Args:
        folder: The folder.

    Returns:
        The runs.

    Raises:
        UserError: There is no such folder; code `user.no_runs`.
    """
    if not folder.is_dir():
        raise UserError(f"there is no folder {folder}: give the --out of the runs", code="user.no_runs")
    return [_read(path) for path in sorted(folder.iterdir(), key=_order) if (path / RECORDING).is_file()]


def recording_of(run: Path) -> Path:
    """The recording of a run.

    Args:
        run: The run's folder, or the recording itself.

    Returns:
        The file.

    Raises:
        UserError: There is none; code `user.no_recording`.
    """
    path = run / RECORDING if run.is_dir() else run
    if not path.is_file():
        raise UserError(f"{run} holds no {RECORDING}: `toolee runs` lists the runs", code="user.no_recording")
    return path


def _order(path: Path) -> str:
    return path.name.removeprefix(".")


def _read(path: Path) -> Run:
    try:
        summary: dict[str, Any] = json.loads((path / "summary.json").read_text())
    except (OSError, ValueError):
        summary = {}
    try:
        date = datetime.strptime("-".join(_order(path).split("-")[:2]), "%Y%m%d-%H%M%S")
    except ValueError:
        date = datetime.fromtimestamp((path / RECORDING).stat().st_mtime)
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    get = summary.get
    return Run(
        path, date, get("source") or "", get("seed"), get("outcome") or UNFINISHED, get("success"), get("strikes"),
        get("seconds"), get("robot_seconds"), size / 1e6,
    )  # fmt: skip
