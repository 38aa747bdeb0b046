"""`toolee hammer`: the whole job on the simulated station."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.config import StationConfig, load_station
from toolee_robot.errors import UserError


@dataclass(frozen=True)
class Hammer:
    """Take a hammer from a person, look at it, and drive the nail (simulated station).

    Example: toolee hammer --seed 100 --json

    Exit code 0: the nail is flush; 1: it is not, and the reason is said; 2: the input was wrong; 130: interrupted,
    the arm was stopped.
    """

    seed: int = 0
    """Which hammer (none was used in training), which grasp, which noise."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""
    no_correction: Flag = False
    """Strike as if the tool were where it nominally is in the hand: the baseline."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """A station: any subset of the fields of toolee_robot/config.py."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs")
    """Where the run's folder goes: summary.json, recording.mcap, picture.png."""
    gui: Flag = False
    """Show pybullet's window (needs a screen)."""
    perfect_perception: Flag = False
    """For tests and the ablation only: poses from the simulation's ground truth instead of the camera."""

    def run(self) -> int:
        if not 0 <= self.seed < 2**31:
            raise UserError(f"--seed {self.seed}: give a whole number from 0 to {2**31 - 1}")
        if self.gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            raise UserError("--gui needs a screen and DISPLAY is not set: leave it out, headless does the same job")
        if self.perfect_perception and self.no_correction:
            raise UserError("--perfect-perception with --no-correction changes nothing: leave one out")
        config = StationConfig() if self.config is None else load_station(self.config)
        console = Console(stderr=self.json, highlight=False)

        from toolee_robot.cli.run_folder import run_folder

        with run_folder(self.out, f"seed{self.seed}") as folder:
            console.print("[dim]loading the networks and building the station[/dim]")
            from toolee_robot.cli.job import HammerJob  # seconds of loading: after everything that can be wrong at once

            correction, perfect = not self.no_correction, self.perfect_perception
            job = HammerJob(config, self.seed, correction=correction, perfect_perception=perfect, gui=self.gui)
            report = job.run(folder.path, console)
            folder.keep()
        console.print(report.panel(folder.path))
        if self.json:
            print(json_line({**report.figures, "run_folder": str(folder.path)}), flush=True)
        return report.exit_code
