"""`toolee station check`: what a station file lacks, then the doctor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.doctor import Doctor
from toolee_robot.cli.options import Flag
from toolee_robot.errors import ConfigError
from toolee_robot.station import check_current, load_lab_station, load_station, read_station


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
        from toolee_robot.robots import hand_model
        from toolee_robot.stations.lab import check_purpose
        from toolee_robot.stations.open_fields import open_fields, told

        console = Console(stderr=self.json, highlight=False)
        data = read_station(self.file)
        check_current(data, self.file)
        fields = open_fields(data, self.file)
        if any(not entry.note for entry in fields):
            raise ConfigError(_wrong(self.file) + told(fields, self.file), code="config.unmeasured")
        config = load_lab_station(self.file)
        check_purpose(config)
        hand_model(config.hand)
        if fields:
            console.print(escape(told(fields, self.file)), soft_wrap=True)
        console.print("Nothing that a job needs is missing in the file. Whether it is right:")
        return Doctor(config=self.file, json=self.json).run()


def _wrong(file: Path) -> str:
    """What is wrong in a file that lacks something, too."""
    try:
        load_station(file)
    except ConfigError as error:
        return f"{error}\n"
    return f"{file} is not complete\n"
