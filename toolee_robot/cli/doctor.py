"""`toolee doctor` checks a station before any motion; `toolee devices` lists the drivers that its file may name."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.output import STATION, Flag, JsonOption
from toolee_robot.errors import UserError
from toolee_robot.findings import Finding, Level, worst

if TYPE_CHECKING:
    from toolee_robot.frames import Array
    from toolee_robot.station import StationConfig

_MARK = {Level.OK: "[green]✓[/green]", Level.WARN: "[yellow]![/yellow]", Level.FAIL: "[bold red]✗[/bold red]"}
_STYLE = {Level.OK: "none", Level.WARN: "yellow", Level.FAIL: "red"}


@dataclass(frozen=True)
class Doctor(JsonOption):
    """Check a station before any motion: robot, devices, station file, this computer. Nothing is moved.

    Example: toolee doctor

    Example: toolee doctor --station lab.yaml

    Example: toolee doctor --station lab.yaml --inputs

    Exit code 0: ready, or warnings only; 1: a fault must be repaired first; 2: invalid input.
    """

    robot_host: Annotated[
        str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: arm.host of the station file)")
    ] = None
    """Address of the UR controller: a robot's, or that of `toolee emulate ur`. If there is none, no device is asked."""
    config: Annotated[Path | None, STATION] = None
    """A station: any subset of the fields in docs/reference/station_file.md."""
    jogged_point: Annotated[
        tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z", help_behavior_hint="")
    ] = None
    """X Y Z of the TCP in millimetres, as the pendant's Move screen shows them with the feature Base. They are
    compared with the robot's report. If left out, the command asks at the terminal, except with --json.
    """
    inputs: Flag = False
    """Check door and hold-to-run switch (`person` in the station file): the command asks you to operate each once.
    It connects with the arm's driver and starts the robot's program, but moves nothing.
    """
    write: Flag = False
    """Enter the kinematics that the factory measured on this arm in `measured.yaml` beside the station file."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs")
    """Folder for recordings, whose free space is checked."""

    def run(self) -> int:
        from toolee_robot.station import load_station, sim_station

        config = sim_station() if self.config is None else load_station(self.config)
        host = self.robot_host or config.arm.host
        options = (("--jogged-point", self.jogged_point), ("--inputs", self.inputs))
        for option, given in options:
            if host is None and given:
                raise UserError(
                    f"{option} needs the controller's address: give --robot-host, or arm.host in the station file. "
                    "The pendant's About page shows it"
                )
        if self.write and None in (host, self.config):
            raise UserError("--write needs --station and a robot: arm.host in the station file, or --robot-host")
        if host is not None:
            config = self._of_robot()
        if self.inputs:
            from toolee_robot.devices.person import check_wired

            check_wired(config)
        console = self.console
        with console.status("loading"):
            from toolee_robot.app.doctor import DoctorReport

        point = None if self.jogged_point is None else 1e-3 * np.array(self.jogged_point)
        tell = (lambda prompt: console.print(f"  [bold]{escape(prompt)}[/bold]")) if self.inputs else None
        # A question that goes into a pipe would be waited for unseen.
        seen = sys.stdin.isatty() and console.is_terminal and not self.json
        ask = (lambda: ask_point(console)) if seen and point is None else None
        report = DoctorReport(config, host, self.out, point, console.status, tell, self.config, ask)
        found: list[tuple[str, Finding]] = []
        for section, findings in report.sections():
            found += [(section, finding) for finding in findings]
            console.print(f"\n[bold]{section}[/bold]")
            console.print(findings_table(findings))
        if self.write:
            self._write(report.facts.get("arm_calibration"))
        level = worst(finding for _, finding in found)
        console.print(f"\n{self._verdict(host, [finding for _, finding in found])}")
        told = [{"section": section, **asdict(finding)} for section, finding in found]
        self.tell({"worst": level, "robot_host": host, **report.facts, "findings": told})
        return int(level is Level.FAIL)

    def _write(self, calibration: Mapping[str, object] | None) -> None:
        """Enter the arm's own kinematics beside the station file."""
        from toolee_robot.station import write_measured

        if calibration is None or self.config is None:
            self.console.print("\n[yellow]The robot does not report its kinematics: nothing was written.[/yellow]")
            return
        file = write_measured(self.config, arm={"calibration": calibration})
        self.console.print(f"\nThis arm's kinematics were written to {escape(str(file))}.", soft_wrap=True)

    def _of_robot(self) -> StationConfig:
        """Load the station of a robot, which never has the simulation's calibration."""
        from toolee_robot.station import load_lab_station, sim_station

        if self.config is None:
            return replace(sim_station(), calibration=None)
        return load_lab_station(self.config, complete=False)

    def _verdict(self, host: str | None, findings: Sequence[Finding]) -> str:
        fails = sum(f.level is Level.FAIL for f in findings)
        warnings = sum(f.level is Level.WARN for f in findings)
        told = f", {_count(warnings, 'warning')}" if warnings else ""
        if fails:
            return f"[bold red]Not ready: {_count(fails, 'fault')} to fix{told}.[/bold red]"
        ready = "the job in simulation" if host is None else "slow, attended motions"
        return f"[bold green]Ready for {ready}[/bold green]{told}."


def ask_point(console: Console) -> Array | None:
    """Ask for the TCP as the teach pendant shows it, until the answer is a point or none.

    Args:
        console: Where the question goes.

    Returns:
        The point in the pendant's Base, (3,) [m]; None if the person skips the question.
    """
    from toolee_robot.doctor.frames import parse_point

    console.print(
        "\nJog the arm near the work with the pendant, and leave it there. Which [bold]X Y Z[/bold] of the TCP "
        "does the Move screen show with the feature [bold]Base[/bold], in millimetres? [dim](Enter: skip)[/dim]",
        soft_wrap=True,
    )
    while True:
        try:
            answer = console.input("  > ").strip()
        except EOFError:
            return None
        if not answer:
            return None
        if (point := parse_point(answer)) is not None:
            return point
        console.print("  [yellow]give three numbers with decimal points, such as -691.4 -174.2 676.9[/yellow]")


def findings_table(findings: Iterable[Finding]) -> Table:
    """Format findings, one per line, with the remedy below."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(width=3, justify="right")
    table.add_column(min_width=18)
    table.add_column(overflow="fold")
    for f in findings:
        table.add_row(_MARK[f.level], f.name, f"[{_STYLE[f.level]}]{escape(f.message)}[/]")
        if f.remedy:
            table.add_row("", "", f"→ {escape(f.remedy)}")
    return table


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


@dataclass(frozen=True)
class Devices(JsonOption):
    """List the drivers that a station file may name, and the package of each.

    Example: toolee devices list

    A lab adds drivers in a package of its own: docs/how-to/add_a_camera.md.
    """

    action: Annotated[Literal["list"], tyro.conf.Positional]
    """What to do."""

    def run(self) -> int:
        from toolee_robot.devices.hands import hand_drivers
        from toolee_robot.stations.camera import camera_drivers

        found = {"camera": camera_drivers(), "hand": hand_drivers()}
        table = Table("device", "driver", "from", box=None, pad_edge=False)
        for kind, drivers in found.items():
            for name, source in drivers.items():
                table.add_row(kind, name, source)
        self.console.print(table)
        self.tell(found)
        return 0


COMMANDS = {"doctor": Doctor, "devices": Devices}
