"""The interview of `toolee station new`: what a lab has to say about its station, one field of the file at a time.

What is asked follows from what was answered. The words are those of the fields' own descriptions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from toolee_robot.devices.hands import hand_drivers, wired_hand
from toolee_robot.errors import UserError
from toolee_robot.frames import BaseFrame
from toolee_robot.robots import MOUNT, find_hand
from toolee_robot.robots.hands.model import UNMOUNTED
from toolee_robot.station import (
    MEASURED,
    ArmLimits,
    CameraConfig,
    CameraDevice,
    HandConfig,
    PersonConfig,
    SceneConfig,
    StationConfig,
    StrikeConfig,
    ToolData,
    ToolEnvelope,
    WorkConfig,
    given_by_intrinsics,
    given_by_nails,
    given_by_pose,
    sim_station,
)
from toolee_robot.station.schema import field_docs
from toolee_robot.stations.camera import AIRO, RECORDED, WITH_LENS, WITH_MODE, camera_drivers
from toolee_robot.types import ArmModel, HandEfforts, HandMounting, HandWeight, ToolMount

NONE = "none"
"""The answer of a lab that has no such thing."""
SIZE = ("width", "height")
"""Fields of `camera` that are its mode."""
_LENS = ("fx", "fy", "cx", "cy")
_SEVERAL = -1
INTRINSICS = (*_LENS, *SIZE)
"""Fields of `camera` that its driver tells, where it is connected."""
_DEVICE = ("driver", "serial", "least_range")
_OF_DRIVER: Mapping[str, tuple[str, ...]] = {AIRO: ("camera_class",), RECORDED: ("folder",)}
_FIRST_SPEED = "0.4"
"""Speed of the first strikes on a robot [m/s], as docs/how-to/bring_up_a_ur.md has it."""

_UNASKED = (("scene", "obstacles"), ("arm", "acceleration"), ("supervisor", "unattended_speed"))
"""What a lab may have to say and no question asks for: lists of records, and limits that grow step by step."""


@dataclass(frozen=True)
class Question:
    """One field of the station file.

    Attributes:
        path: Sections and name, such as ("work", "nail_xy").
        hint: Its type.
        text: What it is, with its unit.
        choices: The answers that there are; empty where it is not a choice.
        optional: Whether a lab may have none.
        offered: The answer that Enter gives, of a field without which the simulated station's value would hold unseen;
            empty where there is none that could do.
    """

    path: tuple[str, ...]
    hint: Any
    text: str
    choices: tuple[str, ...] = ()
    optional: bool = False
    offered: str = ""

    @property
    def name(self) -> str:
        """Its name, such as work.nail_xy."""
        return ".".join(self.path)

    def parse(self, answer: str) -> Any:
        """Convert an answer.

        Args:
            answer: What was typed: a number, several with spaces or commas between, in brackets or not, or a text.

        Returns:
            The value as the file holds it.

        Raises:
            UserError: It is none for this field (`user.answer`); the message says why.
        """
        answer = answer.strip().strip("[]()").strip()
        if self.optional and answer.lower() == NONE:
            return None
        if self.choices and answer not in self.choices:
            raise UserError(f"{answer!r} is none of {', '.join(self.choices)}", code="user.answer")
        parts = answer.replace(",", " ").split()
        value: Any = answer
        try:
            if numbers := _count(self.hint):
                value = tuple(float(part) for part in parts)
                if numbers not in (_SEVERAL, len(value)):
                    commas = "; a comma parts numbers, decimals have a point" if "," in answer else ""
                    text = f"{numbers} numbers are needed, {len(value)} were given{commas}"
                    raise UserError(text, code="user.answer")
            elif not self.choices and str not in (self.hint, *get_args(self.hint)):
                value = float(answer)
                value = int(value) if value.is_integer() else value
            TypeAdapter(self.hint).validate_python(value)
        except (ValueError, ValidationError) as error:
            raise UserError(f"{answer!r} does not fit: {_why(error)}", code="user.answer") from error
        return list(value) if isinstance(value, tuple) else value

    @property
    def form(self) -> str:
        """How an answer is written; empty where that needs no words."""
        if self.choices:
            return ", ".join(self.choices)
        if numbers := _count(self.hint):
            return "numbers" if numbers == _SEVERAL else f"{numbers} numbers"
        return ""


def questions(data: dict[str, Any]) -> Iterator[Question]:
    """What a station file still has to say, in the order in which it is asked.

    Args:
        data: What it says so far.

    Yields:
        The questions whose fields are not there.
    """
    for question in _all(data):
        if not _given(data, question.path):
            yield question


def unasked(data: dict[str, Any]) -> list[str]:
    """List what a station file leaves to a default that belongs to no lab, and no question asks for.

    Args:
        data: What it says.

    Returns:
        Names of the fields, such as `scene.obstacles`.
    """
    return [".".join(path) for path in _UNASKED if not _given(data, path)]


def put(data: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    """Enter a value.

    Args:
        data: What the file says so far; changed.
        path: Sections and name.
        value: The value.
    """
    *sections, name = path
    for section in sections:
        data = data.setdefault(section, {})
    data[name] = value


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
            str(e["ctx"]["error"]) for e in error.errors() if e["type"] == "value_error" and e["loc"][:1] == (section,)
        )
    return ""


def take(data: dict[str, Any], path: tuple[str, ...]) -> None:
    """Take an answer back.

    Args:
        data: What the file says so far; changed.
        path: Sections and name.
    """
    *sections, name = path
    for section in sections:
        data = data[section]
    del data[name]


def _given(data: Any, path: tuple[str, ...]) -> bool:
    for name in path:
        if not isinstance(data, dict) or name not in data:
            return False
        data = data[name]
    return True


def _all(data: dict[str, Any]) -> Iterator[Question]:
    frames = tuple(str(frame) for frame in BaseFrame)
    text = "Frame of the positions that follow: pendant_base as the teach pendant shows them (feature Base), base_link "
    yield Question(("frame",), str, f"{text}as ROS does; half a turn about z apart.", frames)
    models = tuple(str(model) for model in ArmModel)
    yield Question(("arm", "model"), str, field_docs(ArmLimits)["model"], models)
    yield from _of(ArmLimits, ("arm",), ("up", "host"))
    yield from _of_hand(data.get("hand") or {})
    device = ("camera", "device")
    yield Question((*device, "driver"), str, field_docs(CameraDevice)["driver"], tuple(camera_drivers()))
    driver = ((data.get("camera") or {}).get("device") or {}).get("driver")
    yield from _of(CameraDevice, device, _OF_DRIVER.get(str(driver), ()))
    yield from _of(CameraDevice, device, _DEVICE[1:])
    yield from _of_camera(data.get("camera") or {})
    yield from _of(SceneConfig, ("scene",), MEASURED["scene"])
    of_nails = given_by_nails((data.get("work") or {}).get("nails"))
    yield from _of(WorkConfig, ("work",), [name for name in MEASURED["work"] if f"work.{name}" not in of_nails])
    block, turn = _of(WorkConfig, ("work",), ("block_xy", "block_turn"))
    yield replace(block, optional=True, offered=NONE)
    yield replace(turn, offered="0")
    records: tuple[tuple[type[Any], str], ...] = ((PersonConfig, "person"), (ToolData, "tool"))
    for record, section in records:
        for question in _of(record, (section,), [field.name for field in fields(record)]):
            yield replace(question, optional=type(None) in get_args(question.hint))
    for question in _of(ToolEnvelope, ("tool_envelope",), [field.name for field in fields(ToolEnvelope)]):
        yield replace(question, offered=f"{getattr(sim_station().tool_envelope, question.path[-1]):g}")
    yield from _of_strikes(data.get("hand") or {})


def _of_strikes(hand: dict[str, Any]) -> Iterator[Question]:
    (speed,) = _of(StrikeConfig, ("strike",), ("speed",))
    yield replace(speed, text=f"{speed.text} On a robot {_FIRST_SPEED} at first.", offered=_FIRST_SPEED)
    model = find_hand(str(hand.get("model")))
    if model is not None and model.yielding is None:
        yield from _of(StrikeConfig, ("strike",), ("deepest",))


def _of_camera(camera: dict[str, Any]) -> Iterator[Question]:
    given = given_by_pose(camera.get("X_base_camera")) | given_by_intrinsics(camera.get("intrinsics"))
    names = [name for name in MEASURED["camera"] if f"camera.{name}" not in given]
    driver = (camera.get("device") or {}).get("driver")
    if driver in WITH_MODE:  # the mode first: the driver opens the camera in it, and the camera then tells the rest
        for question in _of(CameraConfig, ("camera",), sorted(names, key=lambda name: name in _LENS)):
            mode = " Of a mode that the camera has." if question.path[-1] in SIZE else ""
            yield replace(question, text=question.text + mode)
    else:
        yield from _of(CameraConfig, ("camera",), names)
    if driver not in WITH_LENS and "camera.distortion" not in given:  # the others tell it themselves
        (distortion,) = _of(CameraConfig, ("camera",), ("distortion",))
        yield replace(distortion, optional=True, offered=NONE)


def _of_hand(hand: dict[str, Any]) -> Iterator[Question]:
    yield Question(("hand", "model"), str, field_docs(HandConfig)["model"], tuple(hand_drivers()))
    model = hand.get("model")
    if model == MOUNT:
        yield from _of(HandConfig, ("hand",), ("yield_torque",))
        yield from _of(ToolMount, ("hand", "mount"), [field.name for field in fields(ToolMount)])
    elif (known := find_hand(str(model))) is not None:
        yield from _of(HandConfig, ("hand",), ("port",))
        weighed = ("hand", "weighed")
        yield from _of(HandWeight, weighed, [field.name for field in fields(HandWeight)])
        if known.X_flange_root is UNMOUNTED:
            yield from _of(HandMounting, ("hand", "mounting"), [field.name for field in fields(HandMounting)])
        if (kind := wired_hand(str(model))) is not None and kind.measured_efforts:
            yield from _of(HandEfforts, ("hand", "efforts"), [field.name for field in fields(HandEfforts)])
        (strap,) = _of(HandConfig, ("hand",), ("strap_force",))
        yield Question(strap.path, strap.hint, strap.text, optional=True)


def _of(record: type[Any], path: tuple[str, ...], names: Any) -> Iterator[Question]:
    hints, docs = get_type_hints(record, include_extras=True), field_docs(record)
    for name in names:
        yield Question((*path, name), hints[name], docs[name])


def _count(hint: Any) -> int:
    """How many numbers a field holds; 0 for a single value, `_SEVERAL` where it is not said."""
    if type(None) in get_args(hint):
        (hint,) = (kind for kind in get_args(hint) if kind is not type(None))
    if get_origin(hint) is not tuple:
        return 0
    return _SEVERAL if Ellipsis in get_args(hint) else len(get_args(hint))


def _why(error: ValueError | ValidationError) -> str:
    if isinstance(error, ValidationError):
        return "; ".join(str(e.get("ctx", {}).get("error", e["msg"])) for e in error.errors())
    return "a number is needed"
