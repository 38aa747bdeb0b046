"""The trials as one table, for pandas, Polars, DuckDB, R and their like."""

from __future__ import annotations

import io
import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pyarrow
from pyarrow import parquet

from toolee_robot.runtime.files import write_atomic
from toolee_robot.trials.results import Record

TABLE = "trials.parquet"
"""Name of the table, in the trials' folder."""


def write_table(records: Sequence[Record], plan: str, path: Path) -> None:
    """Write a row for each trial, as Parquet.

    The columns are those of the trial (`trial.arm`, `trial.seed`, ...), the figures of its job by the names that
    `--json` gives them (those inside others joined by a dot: `errors.camera_mm`), `command`, and in the
    file's metadata the plan's `hash`. A figure that a job lacks is null; of what a job has several of, such as nails,
    the column holds a list. A column whose values are of several kinds has them as JSON.

    Args:
        records: The trials' results.
        plan: Hash of their plan.
        path: The file, which is replaced.
    """
    rows = [dict(_flat(_row(record))) for record in records]
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    table = pyarrow.table(columns).replace_schema_metadata({"hash": plan})
    stream = io.BytesIO()
    parquet.write_table(table, stream)
    write_atomic(path, stream.getvalue())


def _column(values: list[Any]) -> pyarrow.Array:
    try:
        return pyarrow.array(values)
    except (pyarrow.ArrowException, OverflowError):
        return pyarrow.array([None if value is None else json.dumps(value) for value in values])


def _row(record: Record) -> dict[str, Any]:
    return {"trial": asdict(record.trial), **record.figures, "command": shlex.join(record.command)}


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value
