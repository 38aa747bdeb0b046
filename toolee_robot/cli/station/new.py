"""`toolee station new`: asks for everything that a lab must measure, and writes the station file."""

from __future__ import annotations

import copy
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.config.station import read_station, to_station
from toolee_robot.errors import ConfigError, TooleeError, UserError

if TYPE_CHECKING:
    from toolee_robot.stations.interview import Question

BACK = "<"
"""The answer that takes the one before back."""
HEAD = "# Station file, docs/reference/station_file.md. Lengths in metres, angles in radians.\n"


@dataclass(frozen=True)
class New:
    """Ask for everything that a lab must measure, and write it into a station file.

    Example: toolee station new lab.yaml

    Enter leaves a field open; called again, the open ones are asked. "<" takes the answer before back. Every answer is
    written at once. Nothing is moved.

    Exit code 0: the file is complete but for the calibration; 1: fields are open; they are listed.
    """

    file: tyro.conf.Positional[Path]
    """The station file; one that is there is completed."""

    def run(self) -> int:
        from toolee_robot.stations.interview import questions

        console = Console(highlight=False)
        data: dict[str, Any] = {}
        if self.file.exists():
            data = read_station(self.file)
            if not isinstance(data, dict):
                raise UserError(f"{self.file} is no station file: give another name", code="user.not_a_station")
        else:
            _write(self.file, data)  # before the questions: the place may be none
        before = copy.deepcopy(data)
        console.print(
            'Enter leaves a field open, "<" takes the answer before back. Lengths in metres, angles in radians, masses '
            "in kilograms; decimals with a point.\n",
            soft_wrap=True,
        )
        try:
            _interview(self.file, data, console)
        except (EOFError, KeyboardInterrupt):
            console.print()
        name = f"[bold]{escape(str(self.file))}[/bold]"
        if data != before:  # else its comments stay
            _write(self.file, data)
            console.print(f"Written to {name}.")
        else:
            console.print(f"Nothing new for {name}.")
        left = [question.name for question in questions(data)]
        if left:
            console.print(f"Still open: {', '.join(left)}. `toolee station new {self.file}` asks for them again.")
            return 1
        try:
            to_station(data, self.file)
        except ConfigError as error:
            console.print(f"[yellow]{escape(str(error))}[/yellow]\nCorrect it in the file.")
            return 1
        console.print(
            f"Next: `toolee station show {self.file}`, then rehearse, which moves nothing: "
            f"`toolee calibrate camera --station {self.file} --rehearse --write`.",
            soft_wrap=True,
        )
        return 0


def _interview(file: Path, data: dict[str, Any], console: Console) -> None:
    from toolee_robot.stations.interview import contradiction, put, questions, take

    skipped: set[str] = set()
    answered: list[tuple[str, ...]] = []
    section, asked_camera = "", False
    while question := next((q for q in questions(data) if q.name not in skipped), None):
        if question.path[0] != section:
            section = question.path[0]
            console.print(f"[bold]{section}[/bold]  [dim]{len(list(questions(data)))} fields to go[/dim]")
        if question.path[:1] == ("camera",) and question.path[-1] == "fx" and not asked_camera:
            asked_camera = True
            if _told_by_the_camera(data, console):
                continue
        answer = _ask(question, str(data.get("frame", "base")), console)
        if answer == BACK:
            if answered:
                take(data, answered.pop())
            continue
        if not answer:
            skipped.add(question.name)
            continue
        try:
            put(data, question.path, question.parse(answer))
        except UserError as error:
            console.print(f"  [yellow]{escape(str(error))}[/yellow]")
            continue
        whole = all(q.path[0] != section for q in questions(data))
        if whole and (wrong := contradiction(data, section)):
            take(data, question.path)
            console.print(f'  [yellow]{escape(wrong)}[/yellow]; "<" leads to the answer before', soft_wrap=True)
            continue
        answered.append(question.path)
        _write(file, data)


def _ask(question: Question, frame: str, console: Console) -> str:
    more = f" [dim]({question.form})[/dim]" if question.form else ""
    none = " [dim](or: none)[/dim]" if question.optional else ""
    text = question.text.replace("in `base`", f"in {frame}")
    console.print(f"  [cyan]{question.name}[/cyan]  {escape(text)}{more}{none}", soft_wrap=True)
    if not sys.stdin.isatty():  # no echo: show what was read
        line = sys.stdin.readline()
        if not line:
            raise EOFError
        console.print(f"  > {escape(line.rstrip())}")
        return line.strip()
    return console.input("  > ").strip()


def _told_by_the_camera(data: dict[str, Any], console: Console) -> bool:
    """Fill in the intrinsics from the camera itself, if it is connected."""
    from toolee_robot.config import CameraConfig, CameraDevice
    from toolee_robot.runtime.clock import HostClock
    from toolee_robot.stations.camera import open_camera
    from toolee_robot.stations.interview import INTRINSICS, put

    device = (data.get("camera") or {}).get("device") or {}
    if device.keys() < {"driver", "serial", "least_range"}:
        return False
    try:
        config = CameraConfig(device=CameraDevice(device["driver"], str(device["serial"]), device["least_range"]))
        with open_camera(config, HostClock(), check_intrinsics=False) as camera:
            k = camera.intrinsics
    except TooleeError as error:
        console.print(f"  [dim]the camera does not tell its intrinsics: {escape(str(error))}[/dim]", soft_wrap=True)
        return False
    for name in INTRINSICS:
        put(data, ("camera", name), getattr(k, name))
    told = f"{k.width}x{k.height}, fx {k.fx:.2f}, fy {k.fy:.2f}, cx {k.cx:.2f}, cy {k.cy:.2f}"
    console.print(f"  the camera tells {told}")
    return True


def _write(path: Path, data: dict[str, Any]) -> None:
    import yaml

    from toolee_robot.runtime.files import write_atomic

    text = HEAD + yaml.safe_dump(data, sort_keys=False, default_flow_style=None, allow_unicode=True)
    write_atomic(path, text.encode())
