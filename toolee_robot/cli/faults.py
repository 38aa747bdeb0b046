"""`toolee faults`: measures and prints the fault matrix."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.types import ArmModel

if TYPE_CHECKING:
    from toolee_robot.faults.record import FaultRow
    from toolee_robot.sim_backend.ur_controller.profile import ProfileName


@dataclass(frozen=True)
class Faults:
    """Inject every fault that arm, supervisor and task must survive, and print what they do about it.

    On the simulation and the controller stand-in; nothing here touches a real robot.

    Example: toolee faults --robot UR10 --json

    Exit code 0: every row is handled; 1: one is not.
    """

    robot: Literal["both", "UR10", "UR10e"] = "both"
    """Under which arm's controller stand-in."""
    profile: Literal["both", "ideal", "harsh"] = "both"
    """How that controller follows, measures and stops: exactly, or as one of its generation."""
    only: Literal["all", "arm", "job", "hand", "camera"] = "all"
    """One part of the matrix: arm, which is driver and supervisor on the stand-in; job, which is the task on the
    simulated station; hand or camera, which are the task with the drivers of hands or cameras on emulated ones."""
    fault: str = ""
    """Only the rows whose fault contains this text."""
    host: str = "127.0.0.70"
    """A loopback address for the stand-in."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        if not console.is_terminal:  # a file takes whole rows
            console.width = max(console.width, _ROW)
        from toolee_robot.faults.matrix import MatrixOptions, Part, left_out, run_matrix
        from toolee_robot.runtime.latency_monitor import STALL_LIMIT

        models = tuple(ArmModel) if self.robot == "both" else (ArmModel(self.robot),)
        profiles: tuple[ProfileName, ...] = ("ideal", "harsh") if self.profile == "both" else (self.profile,)
        rows: list[FaultRow] = []
        options = MatrixOptions(self.host, models, profiles, Part(self.only), self.fault)
        with console.status("planning the swing") as status:
            for row in run_matrix(options):
                rows.append(row)
                status.update(f"{len(rows)} rows; last: {row.number} {row.fault}, {row.phase}")
                if not row.handled:
                    why = f"{row.number} {escape(row.fault)}, {row.phase}, {row.on}: {escape(row.why)}"
                    console.print(f"[red]not handled:[/red] {why}", soft_wrap=True)
        rows.sort(key=lambda row: (row.number, row.fault, row.on))
        console.print(_table(rows))
        handled = sum(row.handled for row in rows)
        numbers = sorted({row.number for row in rows if row.number})
        console.print(
            f"\n[bold]{handled} of {len(rows)} rows handled[/bold], faults {', '.join(map(str, numbers))} of 27."
        )
        console.print(
            "[dim]reaction, standstill: after the fault, as the joints of the simulated robot show it. Software guards "
            "are not safety-rated: the robot's own safety system is what protects people.[/dim]"
        )
        again = sum(row.again > 0 for row in rows)
        if again:
            console.print(
                f"{again} of them not at the first try: the machine itself had stalled for over "
                f"{STALL_LIMIT * 1e3:.0f} ms, as a latency monitor saw, or the moment for the fault was missed."
            )
        missing = left_out(options)
        for what in missing:
            console.print(f"[yellow]No rows of[/yellow] {escape(what)}", soft_wrap=True)
        if self.json:
            record = {"handled": handled, "left_out": missing, "rows": [asdict(row) for row in rows]}
            print(json_line(record), flush=True)
        return int(handled < len(rows))


_ROW = 180  # [characters]


def _table(rows: list[FaultRow]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("", "#", "fault", "when", "on", "got", "reaction", "standstill", "allowed", "off path"):
        table.add_column(name, justify="right" if name in ("#", "reaction", "standstill", "allowed") else "left")
    for row in rows:
        table.add_row(
            "[green]✓[/green]" if row.handled else "[bold red]✗[/bold red]",
            str(row.number or "-"),
            escape(row.fault),
            str(row.phase),
            row.on,
            escape(row.got) + (", latched" if row.latched and "latched" not in row.got else ""),
            _ms(row.reaction),
            _ms(row.standstill),
            _ms(row.allowed),
            "" if row.off_path is None else f"{row.off_path * 1e3:.1f} mrad",
        )
    return table


def _ms(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds * 1e3:.0f} ms"


COMMANDS = {"": Faults}
