"""The runs in a folder."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

from toolee_robot.errors import UserError
from toolee_robot.recording import RECORDING
from toolee_robot.runtime.files import read_json


def list_runs(folder: Path) -> list[dict[str, Any]]:
    """The runs in a folder, the oldest first; what is no run's folder is left out.

    Args:
        folder: The folder.

    Returns:
        Of each run `folder`, `date`, `megabytes`, and of its summary `source`, `seed`, `outcome`, `success`, `strikes`,
        `seconds`, `robot_seconds`. Without a summary, of a run that goes on or was killed, the outcome is "unfinished",
        and the others are None.

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


def _read(path: Path) -> dict[str, Any]:
    try:
        summary: dict[str, Any] = read_json(path / "summary.json")
    except (OSError, ValueError):
        summary = {}
    try:
        date = datetime.strptime("-".join(_order(path).split("-")[:2]), "%Y%m%d-%H%M%S")
    except ValueError:
        date = datetime.fromtimestamp((path / RECORDING).stat().st_mtime)
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    told = {name: summary.get(name) for name in ("seed", "success", "strikes", "seconds", "robot_seconds")}
    return {
        "folder": str(path), "date": date.isoformat(), "source": summary.get("source") or "",
        "outcome": summary.get("outcome") or "unfinished", "megabytes": size / 1e6, **told,
    }  # fmt: skip
