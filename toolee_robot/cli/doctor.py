"""`toolee doctor`: is everything as it must be, before anything moves?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.config import StationConfig, load_station
from toolee_robot.errors import UserError
from toolee_robot.findings import Finding, Level, worst

if TYPE_CHECKING:
    from toolee_robot.hal import Station

_MARK = {Level.OK: "[green]✓[/green]", Level.WARN: "[yellow]![/yellow]", Level.FAIL: "[bold red]✗[/bold red]"}
_COLOUR = {Level.OK: "", Level.WARN: "yellow", Level.FAIL: "red"}


@dataclass(frozen=True)
class Doctor:
    """Check a station before any motion: robot, devices, configuration, this computer. Nothing is moved.

    Example: toolee doctor

    Example: toolee doctor --config lab.yaml --arm ur-rtde --robot-host 192.168.1.10

    Exit code 0: ready, or warnings only; 1: something must be mended first, the line says what; 2: the input was wrong.
    """

    arm: Literal["sim", "ur-rtde"] = "sim"
    """The simulated station, or a UR controller on the network (a real one or `toolee ur-controller`)."""
    robot_host: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="")] = None
    """Of the UR controller, with --arm ur-rtde."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """A station: any subset of the fields of toolee_robot/config.py."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs")
    """Where recordings would go."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        if self.arm == "ur-rtde" and not self.robot_host:
            raise UserError("--arm ur-rtde needs --robot-host: the controller's address, as on its About page")
        if self.arm == "sim" and self.robot_host:
            raise UserError("--robot-host without --arm ur-rtde: the simulated arm has no address")
        config = StationConfig() if self.config is None else load_station(self.config)
        console = Console(stderr=self.json, highlight=False)
        record: dict[str, Any] = {"arm": self.arm, "robot_host": self.robot_host}
        found: list[tuple[str, Finding]] = []
        for section, findings in self._sections(config, console, record):
            found += [(section, finding) for finding in findings]
            console.print(f"\n[bold]{section}[/bold]")
            console.print(_table(findings))
        level = worst(finding for _, finding in found)
        console.print(f"\n{_verdict([f for _, f in found], self.arm)}")
        if self.json:
            record["worst"] = str(level)
            record["findings"] = [{"section": section, **asdict(finding)} for section, finding in found]
            print(json_line(record), flush=True)
        return int(level is Level.FAIL)

    def _sections(
        self, config: StationConfig, console: Console, record: dict[str, Any]
    ) -> Iterator[tuple[str, list[Finding]]]:
        """The robot first: where it is wrong, the rest is not worth waiting for a person who knows."""
        with console.status("loading"):
            from toolee_robot import doctor

        camera_serial: str | None = None
        if self.arm == "ur-rtde":
            assert self.robot_host is not None
            with console.status(f"asking the robot at {self.robot_host}"):
                robot = doctor.examine_robot(self.robot_host, config)
            record["robot_serial"] = robot.serial
            record["arm_calibration"] = None if robot.calibration is None else asdict(robot.calibration)
            yield "Robot", robot.findings
            yield "Devices", list(_without_driver())
            robot_serial = robot.serial
        else:
            with console.status("building the simulated station"), _simulated(config) as station:
                devices = list(_devices(station, config))
                robot_serial, camera_serial = station.robot_serial, station.camera_serial
            yield "Devices (simulated)", devices
        with console.status("planning"):
            findings = [
                doctor.check_calibration(config, robot_serial, camera_serial, date.today()),
                *doctor.check_limits(config),
                *doctor.check_reach(config),
            ]
        yield "Station file", findings
        with console.status("loading the networks, trying the servo's schedule"):
            findings = [doctor.check_weights(), doctor.check_disk(self.out), *doctor.check_processor()]
            if self.arm == "ur-rtde":
                findings += doctor.check_real_time(robot.rate)
        yield "This computer", findings


def _devices(station: Station, config: StationConfig) -> Iterator[Finding]:
    from toolee_robot import doctor

    yield doctor.check_arm(station.arm, station.hand, config)
    yield doctor.check_hand(station.hand, config)
    yield from doctor.check_camera(station.camera, station.clock, config)
    yield doctor.check_person(station.person)


def _without_driver() -> Iterator[Finding]:
    for name in ("hand", "camera"):
        yield Finding(Level.WARN, name, "has no driver here yet: nothing was checked", "look after it yourself")


@contextmanager
def _simulated(config: StationConfig) -> Iterator[Station]:
    from toolee_robot.sim_backend.station import SimStation

    with SimStation.build(config) as simulation:
        yield simulation.station


def _table(findings: Iterable[Finding]) -> Table:
    """A line each; what to do stands under what is wrong."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(width=3, justify="right")
    table.add_column(min_width=18)
    table.add_column(overflow="fold")
    for f in findings:
        colour = _COLOUR[f.level]
        says = escape(f.says)
        table.add_row(_MARK[f.level], f.name, f"[{colour}]{says}[/{colour}]" if colour else says)
        if f.do:
            table.add_row("", "", f"→ {escape(f.do)}")
    return table


def _verdict(findings: Sequence[Finding], arm: str) -> str:
    fails = sum(f.level is Level.FAIL for f in findings)
    warnings = sum(f.level is Level.WARN for f in findings)
    told = f", {warnings} warning{'' if warnings == 1 else 's'}" if warnings else ""
    if fails:
        return f"[bold red]Not ready: {fails} thing{'' if fails == 1 else 's'} to mend{told}.[/bold red]"
    what = "the simulated job" if arm == "sim" else "a slow, attended motion"
    return f"[bold green]Ready for {what}[/bold green]{told}."
