"""The template of a lab's station file, and its interview: what a lab has to say, one field at a time.

Which fields apply follows from arm, hand and camera. The words are those of the fields' own descriptions.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
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
    given_by_intrinsics,
    given_by_nails,
    given_by_pose,
    sim_station,
)
from toolee_robot.station.schema import ANY_NUMBER, StationField, record_fields
from toolee_robot.stations.camera import AIRO, RECORDED, WITH_LENS, WITH_MODE, camera_drivers

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
}
"""The answer that Enter gives, of fields of which most labs have the same."""
UNASKED = ("scene.obstacles", "arm.acceleration", "supervisor.unattended_speed")
"""What a lab may have to say and no question asks for: lists of records, and limits that grow step by step."""
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
    own = {AIRO: ("camera_class",), RECORDED: ("folder",)}.get(driver, ())
    yield from (f"camera.device.{name}" for name in ("driver", *own, "serial", "least_range"))
    given = given_by_pose(get(data, "camera.X_base_camera")) | given_by_intrinsics(get(data, "camera.intrinsics"))
    camera = [f"camera.{name}" for name in MEASURED["camera"]]
    if driver in WITH_MODE:  # the mode first: the driver opens the camera in it, and the camera then tells the rest
        camera.sort(key=lambda name: name.endswith(INTRINSICS[:4]))
    if driver not in WITH_LENS:
        camera.append("camera.distortion")
    yield from (name for name in camera if name not in given)
    yield from (f"scene.{name}" for name in MEASURED["scene"])
    work = [f"work.{name}" for name in MEASURED["work"]]
    yield from (name for name in work if name not in given_by_nails(get(data, "work.nails")))
    yield from ("work.block_xy", "work.block_turn")
    for section in ("person", "tool", "tool_envelope"):
        yield from _all_of(section)
    yield "strike.speed"
    if known is not None and known.yielding is None:
        yield "strike.deepest"


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
        UserError: It is none for this field (`user.answer`); the message says why.
    """
    answer = answer.strip().strip("[]()").strip()
    if nullable(field) and answer.lower() == NONE:
        return None
    if (possible := choices(field)) and answer not in possible:
        raise UserError(f"{answer!r} is not supported. Choose one of {', '.join(possible)}", code="user.answer")
    value: Any = answer
    if field.numbers:
        value = answer.replace(",", " ").split()
        if field.numbers not in (ANY_NUMBER, len(value)):
            commas = "; separate numbers by commas, and use decimal points" if "," in answer else ""
            raise UserError(f"give {field.numbers} numbers, not {len(value)}{commas}", code="user.answer")
    if not answer:
        raise UserError("give an answer", code="user.answer")
    try:
        typed = TypeAdapter(field.hint).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        why = str(first.get("ctx", {}).get("error", first["msg"].lower()))
        raise UserError(f"{answer!r} does not fit: {why}", code="user.answer") from error
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
    if isinstance(camera := probe.get("camera"), dict):  # the loader takes them, as it does those two
        probe["camera"] = {n: value for n, value in camera.items() if n not in ("X_base_camera", "intrinsics")}
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
    return "\n".join(lines) + "\n"
