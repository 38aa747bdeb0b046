"""Write, check, look at and upgrade the station file of a lab.

Example: toolee station new lab.yaml --arm UR10e --hand mount --camera orbbec
"""

from __future__ import annotations

import copy
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.output import Flag, JsonOption
from toolee_robot.errors import ConfigError, TooleeError, UserError
from toolee_robot.runtime.files import write_atomic

if TYPE_CHECKING:
    from toolee_robot.station.schema import StationField

BACK = "<"
"""The answer that goes back to the previous question."""


@dataclass(frozen=True)
class New:
    """Write a commented template of a lab's station file.

    It has only the fields that apply. Fill them in.

    Example: toolee station new lab.yaml --arm UR10e --hand inspire --camera realsense

    With --ask the command asks for every field. Enter accepts the offered answer, or leaves the field open. "<" goes
    back. Every answer is saved at once, and a second call with --ask asks for the open fields. Nothing moves.

    Exit code 0: the file is written, with --ask complete except for what commands measure; 1: fields are open.
    """

    file: tyro.conf.Positional[Path]
    """The station file."""
    arm: Annotated[str | None, tyro.conf.arg(metavar="MODEL", help_behavior_hint="")] = None
    """Model of the arm: UR10 or UR10e."""
    hand: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """The hand, as `toolee devices list` prints it, or the beginning of its name, such as inspire; mount for a tool
    mount.
    """
    camera: Annotated[str | None, tyro.conf.arg(metavar="DRIVER", help_behavior_hint="")] = None
    """The camera's driver, as `toolee devices list` prints it."""
    ask: Flag = False
    """Ask for every field."""

    def run(self) -> int:
        from toolee_robot.station.station import read_typed
        from toolee_robot.stations.template import put, template

        console, data = Console(highlight=False), dict[str, Any]()
        if self.file.exists():
            data = read_typed(self.file)
            if not self.ask or not isinstance(data, dict):
                raise UserError(f"{self.file} already exists. Give another name, or --ask")
            if template(data) != self.file.read_text(encoding="utf-8"):
                raise UserError(
                    f"{self.file} was edited by hand, so no command edits it. Fill in the rest yourself; `toolee "
                    f"station check {self.file}` lists it"
                )
        given = {"arm.model": self.arm, "hand.model": self.hand, "camera.device.driver": self.camera}
        for name, value in given.items():
            if value is not None:
                put(data, name, _chosen(name, value))
            elif not self.ask:
                raise UserError("give --arm, --hand and --camera, or --ask")
        write_atomic(self.file, template(data).encode())  # before the questions: the place may be none
        if self.ask:
            return _ask_all(self.file, data, console)
        console.print(f"Written: {escape(str(self.file))}. Fill it in, then run `toolee station check {self.file}`.")
        return 0


def _chosen(name: str, value: str) -> str:
    from toolee_robot.stations.template import applicable, choices

    possible = choices(next(field for field in applicable({}) if field.name == name))
    found = [value] if value in possible else [one for one in possible if one.startswith(value)]
    if len(found) != 1:
        raise UserError(f"{value!r} is not supported. Choose one of {', '.join(possible)}")
    return found[0]


def _ask_all(file: Path, data: dict[str, Any], console: Console) -> int:
    from toolee_robot.station.station import to_station
    from toolee_robot.stations.template import UNASKED, get, open_fields, open_questions, told

    console.print(
        'Press Enter to accept the offered answer, or to leave the field open. Type "<" to go back to the previous '
        "answer. Give lengths in metres, angles in radians, masses in kilograms. Use decimal points.\n"
    )
    try:
        _interview(file, data, console)
    except (EOFError, KeyboardInterrupt):
        console.print()
    console.print(f"Saved in {escape(str(file))}.", soft_wrap=True)
    if fields := open_fields(data, file):
        console.print(f"\n[bold]Still open[/bold]\n{escape(told(fields))}", soft_wrap=True)
    if open_questions(data):
        return 1
    try:
        config = to_station(data, file)
    except ConfigError as error:
        console.print(f"\n[yellow]{escape(str(error))}[/yellow]\nCorrect it in the file.", soft_wrap=True)
        return 1
    from toolee_robot.doctor.configuration import check_sides  # it takes seconds: after the questions
    from toolee_robot.findings import Level

    if (sides := check_sides(config)).level is not Level.OK:
        console.print(f"\n[yellow]{escape(sides.message)}[/yellow]\n→ {escape(sides.remedy)}", soft_wrap=True)
    left = [name for name in UNASKED if get(data, name) is None]
    console.print(f"\nNot asked, with defaults: {', '.join(left)}. Add them to change them.", soft_wrap=True)
    console.print(f"\nNext: `toolee station show {file}`, then a rehearsal (nothing moves).", soft_wrap=True)
    return 0


def _interview(file: Path, data: dict[str, Any], console: Console) -> None:
    from toolee_robot.stations.template import OFFERED, contradiction, open_questions, parse, put, template

    skipped: set[str] = set()
    answered: list[dict[str, Any]] = []  # what the file said before each answer
    section, asked_camera = "", False
    while left := [question for question in open_questions(data) if question.name not in skipped]:
        field = left[0]
        if field.path[0] != section:
            section = field.path[0]
            console.print(f"[bold]{section}[/bold]  [dim]{len(left)} questions left[/dim]")
        if field.name == "camera.fx" and not asked_camera:
            asked_camera = True
            if _told_by_the_camera(data, console):
                write_atomic(file, template(data).encode())
                continue
        answer = _ask(field, str(data.get("frame") or "the frame above"), console) or OFFERED.get(field.name, "")
        if not answer:
            skipped.add(field.name)
            continue
        was = copy.deepcopy(data)
        if answer == BACK:
            asked_camera = False
            was = answered.pop() if answered else was
            data.clear()
            data.update(was)
        else:
            try:
                put(data, field.name, parse(field, answer))
            except UserError as error:
                console.print(f"  [yellow]{escape(str(error))}[/yellow]")
                continue
            whole = all(q.path[0] != section for q in open_questions(data))
            if whole and (wrong := contradiction(data, section)):
                data.clear()
                data.update(was)
                console.print(f'  [yellow]{escape(wrong)}.[/yellow] Type "<" to go back.', soft_wrap=True)
                continue
            answered.append(was)
        write_atomic(file, template(data).encode())


def _ask(field: StationField, frame: str, console: Console) -> str:
    from toolee_robot.stations.template import OFFERED, choices, nullable

    form = ", ".join(choices(field)) or field.kind.removesuffix(", or null")
    none = " [dim](or: none)[/dim]" if nullable(field) else ""
    offer = f" [dim](Enter: {OFFERED[field.name]})[/dim]" if field.name in OFFERED else ""
    text = escape(field.text.replace("in `base`", f"in {frame}"))
    console.print(f"  [cyan]{field.name}[/cyan]  {text} [dim]({escape(form)})[/dim]{none}{offer}")
    if not sys.stdin.isatty():  # no echo: show what was read
        line = sys.stdin.readline()
        if not line:
            raise EOFError
        console.print(f"  > {escape(line.rstrip())}")
        return line.strip()
    return console.input("  > ").strip()


def _told_by_the_camera(data: dict[str, Any], console: Console) -> bool:
    """Fill in the intrinsics from the camera itself, if it is connected."""
    from toolee_robot.runtime.clock import HostClock
    from toolee_robot.station import CameraDevice, sim_station
    from toolee_robot.stations.camera import WITH_MODE, open_camera
    from toolee_robot.stations.template import INTRINSICS, SIZE

    camera = data.get("camera") or {}
    device, size = camera.get("device") or {}, {name: camera[name] for name in SIZE if camera.get(name)}
    if not device.keys() >= {"driver", "serial", "least_range"}:
        return False
    if device["driver"] in WITH_MODE and len(size) < len(SIZE):
        console.print("  [dim]the camera's intrinsics cannot be read without camera.width and camera.height[/dim]")
        return False
    try:
        config = replace(sim_station().camera, device=CameraDevice(**device), **size)
        with open_camera(config, HostClock(), check_intrinsics=False) as connected:
            k, lens = connected.intrinsics, connected.lens
    except TooleeError as error:
        console.print(f"  [dim]the camera does not report its intrinsics: {escape(str(error))}[/dim]", soft_wrap=True)
        return False
    camera |= {name: getattr(k, name) for name in INTRINSICS}
    console.print(
        f"  the camera reports {k.width}x{k.height}, fx {k.fx:.2f}, fy {k.fy:.2f}, cx {k.cx:.2f}, cy {k.cy:.2f}; "
        f"{lens.words}"
    )
    return True


@dataclass(frozen=True)
class Check(JsonOption):
    """Check a lab's station file, then its devices.

    The devices are checked as `toolee doctor` does. Nothing is moved.

    Example: toolee station check lab.yaml

    Exit code 0: ready, or warnings only; 1: a fault must be repaired first; 2: the file is incomplete or invalid.
    """

    file: tyro.conf.Positional[Path]
    """The station file."""

    def run(self) -> int:
        from toolee_robot.cli.doctor import Doctor
        from toolee_robot.robots import hand_model
        from toolee_robot.station import check_current, load_lab_station, load_station, read_station
        from toolee_robot.stations.lab import check_purpose
        from toolee_robot.stations.template import open_fields, told

        console = self.console
        data = read_station(self.file)
        check_current(data, self.file)
        fields = open_fields(data, self.file)
        if any(not entry.note for entry in fields):
            wrong = f"{self.file} is not complete"
            try:
                load_station(self.file)
            except ConfigError as error:
                wrong = str(error)
            raise ConfigError(f"{wrong}\n{told(fields)}")
        config = load_lab_station(self.file)
        check_purpose(config)
        hand_model(config.hand)
        if fields:
            console.print(escape(told(fields)), soft_wrap=True)
        console.print("The file has everything that a job needs. Now the devices:")
        return Doctor(config=self.file, json=self.json).run()


@dataclass(frozen=True)
class Show:
    """Show a station file in three dimensions.

    The page is on this computer. Ctrl-C ends it.

    Example: toolee station show lab.yaml

    Compare the picture with the lab: half a turn of the base, swapped axes and a camera that looks elsewhere are
    obvious.
    """

    file: tyro.conf.Positional[Path]
    """The station file."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page."""

    def run(self) -> int:
        from toolee_robot.cli.output import serve
        from toolee_robot.station import load_station

        load_station(self.file)  # before Rerun is imported
        console = Console(highlight=False)
        with console.status("building the picture"):
            from toolee_robot.viewer.rerun_page import RerunPage
            from toolee_robot.viewer.station_view import StationView

            view = StationView(self.file)
            page = RerunPage("station", view.blueprint(), self.port)
            view.log(page.stream)
        serve(page, console)
        return 0


@dataclass(frozen=True)
class Upgrade:
    """Upgrade a station file from version 2 to version 3.

    Measured values move to `measured.yaml`.

    Example: toolee station upgrade lab.yaml

    The old file is kept as lab.yaml.v2. Comments, order and layout stay.
    """

    file: tyro.conf.Positional[Path]
    """The station file."""

    def run(self) -> int:
        from toolee_robot.station.upgrade import upgrade
        from toolee_robot.stations.template import open_fields, told

        console = Console(highlight=False)
        done = upgrade(self.file)
        console.print("\n".join(map(escape, done.lines)), soft_wrap=True)
        if needed := [entry for entry in open_fields(done.data, self.file) if not entry.note]:
            console.print(f"\n[bold]Missing[/bold]\n{escape(told(needed))}", soft_wrap=True)
        return int(any(entry.typed for entry in needed))


COMMANDS = {
    "station": {
        "new": New,
        "check": Check,
        "show": Show,
        "upgrade": Upgrade,
    }
}
