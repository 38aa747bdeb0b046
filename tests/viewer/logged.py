"""What was logged to Rerun, read back with its own reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rerun as rr

from toolee_robot.viewer.station_view import TIMELINE


class Logged:
    """A stream of Rerun into a file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.stream = rr.RecordingStream("test")
        self.stream.save(path)

    def read(self) -> dict[str, list[tuple[float, dict[str, Any]]]]:
        """By path what was logged there, in order: time [s] (-1 of what holds always), and values by component."""
        self.stream.flush()
        self.stream.disconnect()
        found: dict[str, list[tuple[float, dict[str, Any]]]] = {}
        for chunk in rr.chunk.RrdReader(self._path).stream():
            batch = chunk.to_record_batch()
            stamps = batch.column(TIMELINE).cast("int64").to_pylist() if TIMELINE in batch.schema.names else None
            names = [name for name in batch.schema.names if ":" in name]
            columns = {name: batch.column(name).to_pylist() for name in names}
            for i in range(batch.num_rows):
                row = {name.split(":")[1]: values[i] for name, values in columns.items() if values[i] is not None}
                rows = found.setdefault(chunk.entity_path.lstrip("/"), [])
                rows.append((-1.0 if stamps is None else stamps[i] * 1e-9, row))
        for rows in found.values():
            rows.sort(key=lambda row: row[0])
        return found


def at(rows: list[tuple[float, dict[str, Any]]], stamp: float, name: str) -> Any:
    """The newest value of a component at a time [s]."""
    return next(row[name] for t, row in reversed(rows) if t <= stamp + 1e-6 and name in row)
