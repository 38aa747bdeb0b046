"""The template of a lab's station file, its interview, and what a file still lacks: who gives it, in a lab's order.

Which fields apply follows from arm, hand and camera. The words are those of the fields' own descriptions.
"""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import TypeAdapter, ValidationError

from toolee_robot.devices.hands import hand_drivers, wired_hand
from toolee_robot.errors import UserError
from toolee_robot.frames import BaseFrame
from toolee_robot.robots import MOUNT, find_hand
from toolee_robot.robots.hands.model import UNMOUNTED
from toolee_robot.station import (
    MEASURED,
    VERSION,
    StationConfig,
    given_by_nails,
    given_by_pose,
    sim_station,
)
from toolee_robot.station.schema import ANY_NUMBER, StationField, record_fields
from toolee_robot.stations.camera import RECORDED, WITH_MODE, camera_drivers

_SOURCES = {
    "frame": "the teach pendant, or ROS",
    "arm": "its name plate, the network",
    "arm.up": "spirit level on the base; or set_gravity in the script of a program that the pendant has saved",
    "hand": "its name plate, scales, spring balance",
    "hand.mount": "ruler, scales, spring balance; docs/how-to/begin_with_a_mount.md",
    "hand.mounting": "ruler",
    "hand.efforts": "`toolee hand efforts`, spring balance; docs/how-to/shadow_hand.md",
    "camera.device": "its label and data sheet",
    "camera": "tape measure",
    "camera.distortion": "the driver's documents, or a calibration by OpenCV or ROS",
    "scene": "teach pendant, tape measure",
    "work": "ruler, calliper; the wood's kind",
    "person": "how door and switch are wired",
    "tool": "ruler and scales",
    "tool_envelope": "calliper",
    "strike": "docs/how-to/first_nail.md",
}
"""Where the numbers of a section, or of a field, come from that a person types in."""
STANDS_IN = "until then the default holds"
"""Note of fields that a job does not refuse to be without."""


@dataclass(frozen=True)
class OpenFields:
    """Fields that are open, and what gives them.

    Attributes:
        section: The section of the file in which they are; empty for the top level.
        names: Their names in it.
        source: Where a person reads them, or the command that measures them.
        typed: Whether a person types them in; `toolee station new --ask` asks for these.
        note: Why a job could do without; empty where it needs them.
    """

    section: str
    names: tuple[str, ...]
    source: str
    typed: bool
    note: str = ""

    @property
    def fields(self) -> str:
        """The fields in few words, such as `camera: fx, fy`, with the note."""
        names = ", ".join(self.names) + (f" ({self.note})" if self.note else "")
        return f"{self.section}: {names}" if self.section else names


def open_fields(data: dict[str, Any], path: Path) -> list[OpenFields]:
    """List what a station file lacks.

    Args:
        data: What the file holds.
        path: The file, for the commands.

    Returns:
        What is open, in the order in which a lab does it: first everything that is typed in, then the commands.
    """
    by_source: dict[tuple[str, str, str], list[str]] = {}
    intrinsics = []
    for field in open_questions(data):
        *sections, name = field.path
        if field.path[0] == "camera" and name in INTRINSICS:
            intrinsics.append(name)
        else:
            required = name in MEASURED.get(field.path[0], ())
            note = STANDS_IN if field.name in OFFERED and not required else ""
            by_source.setdefault((".".join(sections), _source(field.name), note), []).append(name)
    typed = [
        OpenFields(section, tuple(names), source, typed=True, note=note)
        for (section, source, note), names in by_source.items()
    ]
    return [*typed, *_measured(data, tuple(intrinsics), shlex.quote(str(path)))]


def told(fields: list[OpenFields]) -> str:
    """What is open in words.

    Args:
        fields: What is open, at least one.

    Returns:
        A line each, those that are typed in before those that a command measures.
    """
    typed = [f"  {entry.fields}  ({entry.source})" for entry in fields if entry.typed]
    measured = [entry for entry in fields if not entry.typed]
    width = max((len(entry.fields) for entry in measured), default=0)
    lines = ["Type in:", *typed] if typed else []
    lines += ["Measure, each by its command, in this order (docs/how-to/first_nail.md):"] if measured else []
    return "\n".join([*lines, *(f"  {entry.fields:<{width}}  {entry.source}" for entry in measured)])


def _source(field: str) -> str:
    while field not in _SOURCES:
        field = field.rpartition(".")[0]
    return _SOURCES[field]


def _measured(data: dict[str, Any], intrinsics: tuple[str, ...], path: str) -> Iterator[OpenFields]:
    arm, servo, camera = (data.get(name) or {} for name in ("arm", "servo", "camera"))
    if intrinsics:
        device = camera.get("device") or {}
        if device.get("driver") == RECORDED:
            which = f"--recording {shlex.quote(str(device.get('folder') or 'DIR'))}"
        else:
            which = f"--driver {device.get('driver') or 'NAME'} --serial {device.get('serial') or 'NUMBER'}"
        if device.get("driver") in WITH_MODE:
            which += f" --size {camera.get('width') or 'W'} {camera.get('height') or 'H'}"
        yield OpenFields("camera", intrinsics, f"toolee camera show {which}", typed=False)
    if "calibration" not in arm:
        command = f"toolee doctor --station {path} --write"
        yield OpenFields("arm", ("calibration",), command, typed=False, note="recommended")
    if "lag" not in servo:
        command = f"toolee arm lag --station {path} --write"
        yield OpenFields("servo", ("gain", "lookahead", "lag"), command, typed=False, note="recommended")
    if not data.get("calibration"):
        command = f"toolee calibrate camera --station {path} --bars-mm X Y --plate-distance M --plate-mass KG --write"
        if camera.get("X_base_camera") is not None:
            command += "  # or type in the other program's, docs/how-to/calibrate.md"
        yield OpenFields("", ("calibration",), command, typed=False)
        nail, place = (" --nail NAME", "nails") if (data.get("work") or {}).get("nails") else ("", "nail_xy")
        command = f"toolee calibrate nail --station {path}{nail} --bars-mm X Y --thickness-mm T --write"
        yield OpenFields("work", (place, "stand_height"), command, typed=False, note="more exactly")


NONE = "none"
"""The answer of a lab that has no such thing."""
SIZE = ("width", "height")
"""Fields of `camera` that are its mode."""
INTRINSICS = ("fx", "fy", "cx", "cy", *SIZE)
"""Fields of `camera` that its driver tells, where it is connected."""
OFFERED: Mapping[str, str] = {
    "work.block_xy": NONE,
    "work.block_turn": "0",
    "camera.distortion": NONE,
    "strike.speed": "0.4",  # of the first strikes on a robot, docs/how-to/first_nail.md
    "strike.deepest": "0.01",  # likewise
}
"""The answer that Enter gives, of fields of which most labs have the same."""
UNASKED = ("scene.obstacles", "arm.acceleration", "supervisor.unattended_speed")
"""What a lab may have to say and no question asks for: lists of records, and limits that grow step by step."""
SLOW: Mapping[str, str] = {
    "arm.host": "  # Slow first motions: delete this # and the two at the end.\n  #acceleration: 4.0  # rad/s^2",
    "strike.deepest": "\n# Slow first motions\n#supervisor: {unattended_speed: 0.6}  # m/s\n#task: {max_strikes: 400}",
}
"""Comments of the template, each after a field: limits that a lab begins with, and raises step by step."""
HEAD = (
    "# Station file of a lab, docs/reference/station_file.md. Metres, radians, kilograms, seconds.\n# Fill in the "
    f"empty fields. `toolee station check` lists what is missing and how to measure it.\nversion: {VERSION}\n"
)
_FRAME = StationField(
    ("frame",), BaseFrame,
    "Frame of the positions: pendant_base as the teach pendant shows them (feature Base), or base_link as ROS. "
    "They differ by half a turn about z.", MISSING,
)  # fmt: skip
_FIELDS = {field.name: field for field in record_fields(StationConfig)}


def get(data: Any, name: str) -> Any:
    """Look up a field.

    Args:
        data: What a file holds.
        name: Its name, such as camera.device.driver.

    Returns:
        Its value; None where it, or its section, is not there.
    """
    for part in name.split("."):
        data = data.get(part) if isinstance(data, dict) else None
    return data


def put(data: dict[str, Any], name: str, value: Any) -> None:
    """Enter a value.

    Args:
        data: What the file holds; changed.
        name: Name of the field.
        value: The value.
    """
    *sections, last = name.split(".")
    for section in sections:
        data[section] = data.get(section) or {}
        data = data[section]
    data[last] = value


def applicable(data: dict[str, Any]) -> Iterator[StationField]:
    """List what a lab with that arm, hand and camera has to say.

    Args:
        data: What its file says so far.

    Yields:
        The fields, in the order in which they are asked and written.
    """
    yield _FRAME
    yield from map(_FIELDS.__getitem__, _names(data))


def _names(data: dict[str, Any]) -> Iterator[str]:
    yield from ("arm.model", "arm.up", "arm.host", "hand.model")
    model = str(get(data, "hand.model"))
    known, kind = find_hand(model), wired_hand(model)
    if model == MOUNT:
        yield "hand.yield_torque"
        yield from _all_of("hand.mount")
    elif known is not None:
        yield "hand.port"
        yield from _all_of("hand.weighed")
        yield from _all_of("hand.mounting") if known.X_flange_root is UNMOUNTED else ()
        yield from _all_of("hand.efforts") if kind is not None and kind.measured_efforts else ()
        yield "hand.strap_force"
    driver = get(data, "camera.device.driver")
    own = ("folder",) if driver == RECORDED else ()
    yield from (f"camera.device.{name}" for name in ("driver", *own, "serial", "least_range"))
    given = given_by_pose(get(data, "camera.X_base_camera"))
    camera = [f"camera.{name}" for name in MEASURED["camera"]]
    if driver in WITH_MODE:  # the mode first: the driver opens the camera in it, and the camera then tells the rest
        camera.sort(key=lambda name: name.endswith(INTRINSICS[:4]))
    if driver not in WITH_MODE:
        camera.append("camera.distortion")
    yield from (name for name in camera if name not in given)
    yield from (f"scene.{name}" for name in MEASURED["scene"])
    work = [f"work.{name}" for name in MEASURED["work"]]
    yield from (name for name in work if name not in given_by_nails(get(data, "work.nails")))
    yield from ("work.block_xy", "work.block_turn")
    for section in ("person", "tool", "tool_envelope"):
        yield from _all_of(section)
    yield from ("strike.speed", "strike.deepest")


def _all_of(section: str) -> Iterator[str]:
    return (name for name in _FIELDS if name.startswith(f"{section}."))


def choices(field: StationField) -> tuple[str, ...]:
    """The answers that a field has.

    Args:
        field: The field.

    Returns:
        The values; empty where it is not a choice.
    """
    names = {"hand.model": hand_drivers, "camera.device.driver": camera_drivers}
    return tuple(names[field.name]()) if field.name in names else field.choices


def nullable(field: StationField) -> bool:
    """Tell whether a lab may have no such thing, and has to say so.

    Args:
        field: The field.

    Returns:
        Whether `none` is an answer: of the person's contacts, the tool, strap, distortion and block.
    """
    named = field.path[0] in ("person", "tool") or field.name in ("hand.strap_force", *OFFERED)
    return named and field.optional


def open_questions(data: dict[str, Any]) -> list[StationField]:
    """List what a file does not say yet.

    Args:
        data: What it says.

    Returns:
        The fields, in the order in which they are asked.
    """
    return [field for field in applicable(data) if get(data, field.name) is None and not _said_none(data, field)]


def _said_none(data: Any, field: StationField) -> bool:
    *sections, name = field.path
    section = get(data, ".".join(sections)) if sections else data
    return nullable(field) and isinstance(section, dict) and name in section


def parse(field: StationField, answer: str) -> Any:
    """Convert an answer.

    Args:
        field: The field.
        answer: What was typed: a number, several with spaces or commas between, in brackets or not, or a text.

    Returns:
        The value as the file holds it.

    Raises:
        UserError: It is none for this field; the message says why.
    """
    answer = answer.strip().strip("[]()").strip()
    if nullable(field) and answer.lower() == NONE:
        return None
    if (possible := choices(field)) and answer not in possible:
        raise UserError(f"{answer!r} is not supported. Choose one of {', '.join(possible)}")
    value: Any = answer
    if field.numbers:
        value = answer.replace(",", " ").split()
        if field.numbers not in (ANY_NUMBER, len(value)):
            commas = "; separate numbers by commas, and use decimal points" if "," in answer else ""
            raise UserError(f"give {field.numbers} numbers, not {len(value)}{commas}")
    if not answer:
        raise UserError("give an answer")
    try:
        typed = TypeAdapter(field.hint).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        why = str(first.get("ctx", {}).get("error", first["msg"].lower()))
        raise UserError(f"{answer!r} does not fit: {why}") from error
    return list(typed) if isinstance(typed, tuple) else str(typed) if possible else typed


def contradiction(data: dict[str, Any], section: str) -> str:
    """Tell what in a section cannot be together, or is no such thing at all.

    Args:
        data: What the file says so far.
        section: The section that was answered last.

    Returns:
        What is wrong, of the records of which every field is there; empty for nothing.
    """
    probe = {name: value for name, value in data.items() if name not in ("version", "frame", "calibration")}
    if isinstance(camera := probe.get("camera"), dict):  # the loader takes it, as it does those two
        probe["camera"] = {n: value for n, value in camera.items() if n != "X_base_camera"}
        if "X_base_camera" in camera:
            probe["camera"] |= {name: getattr(sim_station().camera, name) for name in ("position", "target")}
    try:
        TypeAdapter(StationConfig).validate_python(probe)
    except ValidationError as error:
        return "; ".join(
            str(e["ctx"]["error"])
            for e in error.errors()
            if e["type"] == "value_error" and e["loc"][:1] == (section,) and len(e["loc"]) < 3
        )
    return ""


def template(data: dict[str, Any]) -> str:
    """Write a lab's station file, commented: what it says, and what is empty.

    Args:
        data: What it says; arm.model, hand.model and camera.device.driver at least tell which fields apply.

    Returns:
        The text.
    """
    lines = [HEAD]
    before: tuple[str, ...] = ()
    for field in applicable(data):
        *sections, name = field.path
        for depth, section in enumerate(sections):
            if before[: depth + 1] != tuple(sections[: depth + 1]):
                lines.append(f"{'' if depth else chr(10)}{'  ' * depth}{section}:")
        before, indent = tuple(sections), "  " * len(sections)
        text = field.text.replace("in `base`", "in the frame above")
        form = ", ".join(choices(field)) or field.kind.removesuffix(", or null")
        none = " null: there is none." if nullable(field) else ""
        lines += textwrap.wrap(
            f"{text} [{form}]{none}", 110, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# "
        )
        value = get(data, field.name)
        blank = value is None and not _said_none(data, field)
        shown = "" if blank else yaml.safe_dump(value, default_flow_style=True, width=200).removesuffix("\n...\n")
        lines.append(f"{indent}{'#' if blank and nullable(field) else ''}{name}: {shown}".rstrip())
        lines += [SLOW[field.name]] if field.name in SLOW else []
    return "\n".join(lines) + "\n"
