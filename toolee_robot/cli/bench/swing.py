"""`toolee bench-swing`: swings against straight strikes over the workspace, and the planning time."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from typing import Annotated, Literal

import numpy as np
import tyro
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.host_info import describe_machine
from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError
from toolee_robot.station import StationConfig
from toolee_robot.types import ArmModel

_TARGET_MS = 300.0


@dataclass(frozen=True)
class BenchSwing:
    """Plan swings and straight strikes for random nails and in-hand offsets, and compare what meets the nail.

    Example: toolee bench-swing --model UR10e --draws 100

    Speed, effective mass (arm, hand and grip rigid) and kinetic energy at the contact, as planned: nothing is moved.
    Exit code 1: a median planning time misses its target.
    """

    model: Literal["UR10", "UR10e"] = "UR10"
    """Model of the arm."""
    draws: Annotated[int, tyro.conf.arg(metavar="N")] = 50
    """Number of nails, each with its own in-hand offset."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Seed of the draws."""
    acceleration: Annotated[float, tyro.conf.arg(metavar="A")] = StationConfig().arm.acceleration
    """Acceleration limit of every joint, rad/s^2."""
    jerk: Annotated[float, tyro.conf.arg(metavar="J")] = StationConfig().arm.jerk
    """Jerk limit of every joint, rad/s^3."""
    station_speed: Annotated[float, tyro.conf.arg(metavar="V")] = StationConfig().supervisor.unattended_speed
    """Largest speed of any point of hand and tool, m/s."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        if self.draws < 3:
            raise UserError(f"--draws {self.draws}: give at least 3", code="user.draws")
        if not (self.acceleration > 0 and self.jerk > 0 and self.station_speed > 0):
            raise UserError("--acceleration, --jerk and --station-speed must be positive", code="user.limits")
        from toolee_robot.cli.bench.swing_draws import KINDS, compare

        console = Console(stderr=self.json, highlight=False)
        load = os.getloadavg()[0]
        with console.status(f"planning {self.draws} nails"):
            strikes = compare(
                ArmModel(self.model), self.draws, self.seed, self.acceleration, self.jerk, self.station_speed
            )
        table = Table(title=f"{self.model}, {self.draws} nails", box=SIMPLE, padding=0)
        for name in ("motion", "n", "m/s", "kg", "J", "mm", "torque", "ms", "CPU ms"):
            table.add_column(name, justify="left" if name == "motion" else "right", no_wrap=True)
        slowest = 0.0
        for kind in KINDS:
            rows = [s for s in strikes if s.kind == kind]
            found = [s for s in rows if s.speed > 0]
            if not found:
                table.add_row(kind, "0")
                continue
            wall, cpu = np.array([(s.planning_ms, s.cpu_ms) for s in found]).T
            if kind.startswith("swing"):
                slowest = max(slowest, float(np.median(wall)))
            table.add_row(
                kind,
                str(len(found)),
                escape(_spread([s.speed for s in found])),
                f"{np.median([s.effective_mass for s in found]):.1f}",
                escape(_spread([s.energy for s in found])),
                f"{1e3 * np.median([s.depth for s in found]):.0f}",
                f"{np.max([s.torque for s in found]):.2f}",
                escape(f"{np.median(wall):.0f} [{np.percentile(wall, 95):.0f}]"),
                escape(f"{np.median(cpu):.0f} [{np.percentile(cpu, 95):.0f}]"),
            )
        console.print(table)
        console.print(
            "Medians, in brackets 5 % (of the times 95 %). m/s, kg, J: speed, effective mass and kinetic energy at the "
            "contact along the nail's axis. mm: deepest place of the command beyond it. torque: the largest over "
            "the rated one. ms: planning time, wall clock and processor.",
            style="dim",
            markup=False,
        )
        met = slowest < _TARGET_MS
        verdict = "[green]met[/green]" if met else "[red]missed[/red]"
        console.print(f"median planning time of a swing under {_TARGET_MS:.0f} ms: {verdict} (load before: {load:.1f})")
        if self.json:
            record = {
                "machine": asdict(describe_machine()),
                "load_before": load,
                "model": self.model,
                "strikes": [asdict(s) for s in strikes],
                "met": met,
            }
            print(json_line(record), flush=True)
        return 0 if met else 1


def _spread(values: list[float]) -> str:
    low, middle = np.percentile(values, [5, 50])
    return f"{middle:.2f} [{low:.2f}]"


COMMANDS = {"": BenchSwing}
