"""The fault matrix: every fault that arm, supervisor and task must survive, measured row by row.

    python -m tests.faults.matrix --robot UR10e --profile harsh --part arm
    python -m tests.faults.matrix --json rows.json --write

Arm and network faults are injected into the controller stand-in under the real driver, faulty commands into the
supervisor in front of it, the others into the simulated station under the real task. Run it on a machine that does
nothing else. `--write` enters the rows that are handled into the table of docs/concepts/safety.md, fault by fault.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tests.faults.record import FaultRow, Measurement
from tests.faults.rows.arm import arm_rows
from tests.faults.rows.cameras import camera_rows, missing_cameras
from tests.faults.rows.collisions import collision_rows, restricted_rows
from tests.faults.rows.commands import command_rows
from tests.faults.rows.hands import hand_rows
from tests.faults.rows.inputs import input_rows, switch_rows
from tests.faults.rows.job import job_rows
from tests.faults.rows.process import following_rows, process_rows
from tests.faults.rows.released_stops import released_rows
from tests.faults.rows.start import calibration_rows, start_rows
from tests.rigs.driver_rig import rig
from tests.rigs.job_rig import Bench
from tests.rigs.setting import Setting
from toolee_robot.runtime.latency_monitor import CpuKeepalive, LatencyMonitor
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.types import ArmModel

PAGE = Path(__file__).parents[2] / "docs" / "concepts" / "safety.md"
HOST = "127.0.0.70"
"""A loopback address of its own for the stand-in."""
PARTS = {
    "arm": "driver and supervisor on the stand-in",
    "job": "the task on the simulated station",
    "hand": "the task with the hands' drivers on emulated hands",
    "camera": "the task with the cameras' drivers on emulated cameras",
}
_RIG_ROWS = (arm_rows, command_rows, released_rows, following_rows, input_rows, switch_rows, collision_rows)


def arm_part(setting: Setting, stack: ExitStack | None) -> Iterator[Measurement]:
    """Yield the rows of one controller; without a stack nothing is started, and they can be listed only."""
    controller: Any = None
    arm_rig: Any = SimpleNamespace(name=setting.name, setting=setting)
    if stack is not None:
        stand_in = ControllerProcess(model=setting.model.value, host=setting.host, profile=setting.profile)
        controller = stack.enter_context(stand_in)
    yield from start_rows(setting, controller)
    if stack is not None:
        stack.close()
        arm_rig = stack.enter_context(rig(setting))
    for rows in _RIG_ROWS:
        yield from rows(arm_rig)
    if stack is not None:
        stack.close()
    yield from restricted_rows(setting)
    yield from process_rows(setting)


def job_part(parts: Sequence[str], stack: ExitStack | None) -> Iterator[Measurement]:
    """Yield the rows of the simulated station; without a stack as `arm_part`."""
    bench: Any = None
    if stack is not None:
        bench = Bench()
        stack.enter_context(bench.sim)
    if "job" in parts:
        yield from calibration_rows(bench)
        yield from job_rows(bench)
    if "hand" in parts:
        yield from hand_rows(bench)
    if "camera" in parts:
        yield from camera_rows(bench)


def matrix(
    parts: Sequence[str], models: Sequence[ArmModel], profiles: Sequence[ProfileName], stack: ExitStack | None = None
) -> Iterator[Measurement]:
    """Yield all rows in the order of their measurement; without a stack they can be listed only."""
    if "arm" in parts:
        for profile in profiles:
            for model in models:
                yield from arm_part(Setting(model, HOST, profile), stack)
    if set(parts) - {"arm"}:
        yield from job_part(parts, stack)


def table_with(page: str, cells: dict[int, str]) -> str:
    """A page whose table of faults says of each number, in its last column, what `cells` says."""

    def with_cell(line: re.Match[str]) -> str:
        number = int(line["number"])
        return f"{line['start']}| {cells[number]} |" if number in cells else line[0]

    return re.sub(r"^(?P<start>\| (?P<number>\d+) \|.*)\| [^|]* \|$", with_cell, page, flags=re.MULTILINE)


def handled(rows: Sequence[FaultRow]) -> dict[int, str]:
    """How many rows of each fault's number are handled."""
    of, good = Counter(row.number for row in rows), Counter(row.number for row in rows if row.handled)
    return {number: f"{good[number]} of {count}" for number, count in of.items()}


def _print(console: Console, rows: list[FaultRow]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("", "#", "fault", "when", "on", "got", "reaction", "standstill", "allowed", "off path"):
        table.add_column(name)
    for row in sorted(rows, key=lambda row: (row.number, row.fault, row.on)):
        times = ("" if s is None else f"{s * 1e3:.0f} ms" for s in (row.reaction, row.standstill, row.allowed))
        off_path = "" if row.off_path is None else f"{row.off_path * 1e3:.1f} mrad"
        mark = "✓" if row.handled else "✗"
        table.add_row(mark, str(row.number), escape(row.fault), row.phase, row.on, escape(row.got), *times, off_path)
    console.print(table)
    again = sum(row.again > 0 for row in rows)
    console.print(f"{sum(row.handled for row in rows)} of {len(rows)} rows handled, {again} not at the first try")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and write what is asked for; 1 where a row is not handled."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.matrix", description="Measure the fault matrix.")
    parser.add_argument("--robot", choices=[model.value for model in ArmModel], help="this arm only")
    parser.add_argument("--profile", choices=get_args(ProfileName), help="this kind of controller only")
    parser.add_argument("--part", choices=PARTS, help="; ".join(f"{name}: {text}" for name, text in PARTS.items()))
    parser.add_argument("--fault", default="", metavar="TEXT", help="only rows whose fault contains this text")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
    parser.add_argument("--write", action="store_true", help="enter a whole run into the page")
    asked = parser.parse_args(arguments)
    if asked.write and (asked.robot or asked.profile or asked.part or asked.fault):
        parser.error("--write needs a whole run: leave out what chooses rows")
    parts = [asked.part] if asked.part else list(PARTS)
    models = [ArmModel(asked.robot)] if asked.robot else list(ArmModel)
    profiles = [asked.profile] if asked.profile else list(get_args(ProfileName))
    console = Console(width=None if sys.stdout.isatty() else 180, highlight=False)
    rows: list[FaultRow] = []
    with ExitStack() as stack, CpuKeepalive(), LatencyMonitor() as machine:
        for measurement in matrix(parts, models, profiles, stack):
            if asked.fault not in measurement.fault:
                continue
            rows.append(row := measurement.row(machine))
            why = f": {escape(row.why)}" if row.why else ""
            mark = "handled" if row.handled else "NOT HANDLED"
            console.print(f"{len(rows)} {row.fault}, {row.phase}, {row.on}: {mark}{why}", soft_wrap=True)
    if not rows:
        parser.error(f"no row's fault contains {asked.fault!r}")
    _print(console, rows)
    for missing in missing_cameras() if "camera" in parts else []:
        console.print(f"no rows of {missing}", soft_wrap=True)
    if asked.json:
        asked.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    if asked.write:
        PAGE.write_text(table_with(PAGE.read_text(), handled(rows)))
    return int(not all(row.handled for row in rows))


if __name__ == "__main__":
    sys.exit(main())
