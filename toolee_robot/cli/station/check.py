"""`toolee station check`: what a station file lacks, then the doctor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console

from toolee_robot.cli.doctor import Doctor
from toolee_robot.cli.options import Flag
from toolee_robot.config import load_lab_station


@dataclass(frozen=True)
class Check:
    """Check a lab's station file, then its devices as `toolee doctor` does. Nothing is moved.

    Example: toolee station check lab.yaml

    Exit code 0: ready, or warnings only; 1: a fault must be repaired first; 2: the file lacks something, or is invalid.
    """

    file: tyro.conf.Positional[Path]
    """The station file."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        config = load_lab_station(self.file)
        from toolee_robot.robots import hand_model
        from toolee_robot.stations.lab import check_purpose

        check_purpose(config)
        hand_model(config.hand)
        Console(stderr=self.json, highlight=False).print("Nothing is missing in the file. Whether it is right:")
        return Doctor(config=self.file, json=self.json).run()
