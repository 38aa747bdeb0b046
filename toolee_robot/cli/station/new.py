"""`toolee station new`: asks for everything that a lab must measure, and writes the station file."""

from __future__ import annotations

import copy
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.errors import ConfigError, TooleeError, UserError
from toolee_robot.findings import Level
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.yaml_edit import add_first, set_fields
from toolee_robot.station import VERSION, check_current, sim_station
from toolee_robot.station.station import read_station, to_station

if TYPE_CHECKING:
    from toolee_robot.stations.interview import Question

BACK = "<"
"""The answer that takes the one before back."""
SERVO = "servo: {gain: 1200, lookahead: 0.03, lag: 0.07}"
"""What `toolee arm lag` measures of the controller stand-in, for a rehearsal before a robot's was measured."""
HEAD = "# Station file, docs/reference/station_file.md. Lengths in metres, angles in radians.\n"
"""The first line of a new file."""


@dataclass(frozen=True)
class New:
    """Ask for everything that a lab must measure, and write it into a station file.

    Example: toolee station new lab.yaml

    Enter gives the answer that is offered, or leaves the field open; called again, the open ones are asked. "<" takes
    the answer before back. Every answer is written at once. Nothing is moved.

    Exit code 0: the file is complete but for the calibration; 1: fields are open; they are listed.
    """

    file: tyro.conf.Positional[Path]
    """The station file; one that is there is completed."""

    def run(self) -> int:
        from toolee_robot.stations.interview import questions, unasked
        from toolee_robot.stations.open_fields import open_fields, told

        console = Console(highlight=False)
        if not self.file.exists():
            write_atomic(self.file, HEAD.encode())  # before the questions: the place may be none
        data = read_station(self.file)
        if not isinstance(data, dict):
            raise UserError(f"{self.file} is no station file: give another name", code="user.not_a_station")
        if not data:
            add_first(self.file, "version", VERSION)
            data = read_station(self.file)
        check_current(data, self.file)
        before = copy.deepcopy(data)
        console.print(
            'Enter gives the answer that is offered, or leaves the field open; "<" takes the answer before back. '
            "Lengths in metres, angles in radians, masses in kilograms; decimals with a point.\n",
            soft_wrap=True,
        )
        try:
            _interview(self.file, data, console)
        except (EOFError, KeyboardInterrupt):
            console.print()
        name = f"[bold]{escape(str(self.file))}[/bold]"
        console.print(f"Nothing new for {name}." if data == before else f"Written to {name}.", soft_wrap=True)
        wrong, config = "", None
        if all(question.offered for question in questions(data)):
            try:
                config = to_station(data, self.file)
            except ConfigError as error:
                wrong = str(error)
        if fields := open_fields(data, self.file):
            console.print(f"\n[bold]Still open[/bold]\n{escape(told(fields, self.file))}", soft_wrap=True)
        if wrong:
            console.print(f"\n[yellow]{escape(wrong)}[/yellow]\nCorrect it in the file.", soft_wrap=True)
        if config is None:
            return 1
        from toolee_robot.doctor.configuration import check_sides  # it takes seconds: after the questions

        sides = check_sides(config)
        if sides.level is not Level.OK:
            console.print(f"\n[yellow]{escape(sides.message)}[/yellow]\n→ {escape(sides.remedy)}", soft_wrap=True)
        if left := unasked(data):
            console.print(
                f"\nNot asked for, and by default the simulated station's: {', '.join(left)}; the file takes yours.",
                soft_wrap=True,
            )
        rehearsal = self.file.with_name("rehearsal.yaml")
        servo = "" if "servo" in data else f" and `{SERVO}`, as `toolee arm lag` measures it of the stand-in"
        console.print(
            f"\nNext: `toolee station show {self.file}`, then rehearse with a copy of it, which moves nothing: "
            f"`cp {self.file} {rehearsal}`, and in the copy strike.speed 1.2, which drives a simulated nail{servo}; "
            f"`toolee calibrate camera --station {rehearsal} --rehearse --write`.",
            soft_wrap=True,
        )
        return 0


def _interview(file: Path, data: dict[str, Any], console: Console) -> None:
    from toolee_robot.stations.interview import contradiction, put, questions, take

    skipped: set[str] = set()
    answered: list[tuple[bytes, bytes]] = []  # the file before and after each
    section, asked_camera = "", False
    while question := next((q for q in questions(data) if q.name not in skipped), None):
        if question.path[0] != section:
            section = question.path[0]
            console.print(f"[bold]{section}[/bold]  [dim]{len(list(questions(data)))} fields to go[/dim]")
        if question.path[:1] == ("camera",) and question.path[-1] == "fx" and not asked_camera:
            asked_camera = True
            if _told_by_the_camera(file, data, console):
                continue
        answer = _ask(question, str(data.get("frame", "base")), console) or question.offered
        if answer == BACK:
            if answered:
                _take_back(file, data, answered.pop(), console)
                asked_camera = False
            continue
        if not answer:
            skipped.add(question.name)
            continue
        try:
            value = question.parse(answer)
        except UserError as error:
            console.print(f"  [yellow]{escape(str(error))}[/yellow]")
            continue
        put(data, question.path, value)
        whole = all(q.path[0] != section for q in questions(data))
        if whole and (wrong := contradiction(data, section)):
            take(data, question.path)
            console.print(f'  [yellow]{escape(wrong)}[/yellow]; "<" leads to the answer before', soft_wrap=True)
            continue
        was = file.read_bytes()
        set_fields(file, question.path[:-1], {question.path[-1]: value})
        answered.append((was, file.read_bytes()))


def _take_back(file: Path, data: dict[str, Any], answer: tuple[bytes, bytes], console: Console) -> None:
    before, after = answer
    if file.read_bytes() == after:
        write_atomic(file, before)
        data.clear()
        data.update(read_station(file))
    else:
        console.print("  [yellow]the file has been changed since that answer: correct it there[/yellow]")


def _ask(question: Question, frame: str, console: Console) -> str:
    more = f" [dim]({question.form})[/dim]" if question.form else ""
    none = " [dim](or: none)[/dim]" if question.optional else ""
    offer = f" [dim](Enter: {question.offered})[/dim]" if question.offered else ""
    text = question.text.replace("in `base`", f"in {frame}")
    console.print(f"  [cyan]{question.name}[/cyan]  {escape(text)}{more}{none}{offer}", soft_wrap=True)
    if not sys.stdin.isatty():  # no echo: show what was read
        line = sys.stdin.readline()
        if not line:
            raise EOFError
        console.print(f"  > {escape(line.rstrip())}")
        return line.strip()
    return console.input("  > ").strip()


def _told_by_the_camera(file: Path, data: dict[str, Any], console: Console) -> bool:
    """Fill in the intrinsics from the camera itself, if it is connected."""
    from toolee_robot.runtime.clock import HostClock
    from toolee_robot.station import CameraDevice
    from toolee_robot.stations.camera import WITH_MODE, open_camera
    from toolee_robot.stations.interview import INTRINSICS, SIZE, put

    camera = data.get("camera") or {}
    device, size = camera.get("device") or {}, {name: camera[name] for name in SIZE if name in camera}
    if not device.keys() >= {"driver", "serial", "least_range"}:
        return False
    if device["driver"] in WITH_MODE and len(size) < len(SIZE):
        console.print("  [dim]without camera.width and camera.height the camera is not asked for its intrinsics[/dim]")
        return False
    rate = device.get("fps", CameraDevice.fps)
    own = {name: device.get(name) for name in ("folder", "camera_class")}
    opened = CameraDevice(device["driver"], str(device["serial"]), device["least_range"], rate, **own)
    try:
        config = replace(sim_station().camera, device=opened, **size)
        with open_camera(config, HostClock(), check_intrinsics=False) as connected:
            k, lens = connected.intrinsics, connected.lens
    except TooleeError as error:
        console.print(f"  [dim]the camera does not tell its intrinsics: {escape(str(error))}[/dim]", soft_wrap=True)
        return False
    told = {name: getattr(k, name) for name in INTRINSICS}
    for name, value in told.items():
        put(data, ("camera", name), value)
    set_fields(file, ("camera",), told)
    console.print(
        f"  the camera tells {k.width}x{k.height}, fx {k.fx:.2f}, fy {k.fy:.2f}, cx {k.cx:.2f}, cy {k.cy:.2f}; "
        f"{lens.words}"
    )
    return True
