"""What a station file still lacks: who gives it, in the order in which a lab does it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from toolee_robot.station import MEASURED
from toolee_robot.stations.camera import AIRO, RECORDED, WITH_MODE
from toolee_robot.stations.template import INTRINSICS, OFFERED, open_questions

_SOURCES = {
    "frame": "the teach pendant, or ROS",
    "arm": "its name plate, the network",
    "arm.up": "spirit level on the base; or set_gravity in the script of a program that the pendant has saved",
    "hand": "its name plate, scales, spring balance",
    "hand.efforts": "`toolee hand efforts`, spring balance; docs/how-to/shadow_hand.md",
    "camera.device": "its label and data sheet",
    "camera": "tape measure",
    "camera.distortion": "`toolee calibrate intrinsics --station`, or the driver's documents",
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
        """The fields in few words, such as `camera: fx, fy`."""
        return f"{self.section}: {', '.join(self.names)}" if self.section else ", ".join(self.names)


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
    lines = []
    for typed, head in (
        (True, "Type in:"),
        (False, "Measure, each by its command, in this order (docs/how-to/first_nail.md):"),
    ):
        group = [entry for entry in fields if entry.typed is typed]
        if not group:
            continue
        if typed:
            lines += [head, *(f"  {_marked(entry)}  ({entry.source})" for entry in group)]
        else:
            width = max(len(_marked(entry)) for entry in group)
            lines += [head, *(f"  {_marked(entry):<{width}}  {entry.source}" for entry in group)]
    return "\n".join(lines)


def _marked(entry: OpenFields) -> str:
    return f"{entry.fields} ({entry.note})" if entry.note else entry.fields


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
            if device.get("driver") == AIRO:
                which += f" --camera-class {device.get('camera_class') or 'MODULE.CLASS'}"
        if device.get("driver") in WITH_MODE:
            which += f" --size {camera.get('width') or 'W'} {camera.get('height') or 'H'}"
        yield OpenFields("camera", intrinsics, f"toolee camera show {which}", typed=False)
    if "calibration" not in arm:
        command = f"toolee doctor --config {path} --json  # arm_calibration, docs/how-to/calibrate.md"
        yield OpenFields("arm", ("calibration",), command, typed=False, note="recommended")
    if "lag" not in servo:
        command = f"toolee arm lag --config {path} --write"
        yield OpenFields("servo", ("gain", "lookahead", "lag"), command, typed=False, note="recommended")
    if not data.get("calibration"):
        command = f"toolee calibrate camera --station {path} --bars-mm X Y --plate-distance M --plate-mass KG --write"
        if camera.get("X_base_camera") is not None:
            command += "  # or type in the other program's, docs/how-to/calibrate.md"
        yield OpenFields("", ("calibration",), command, typed=False)
        nail, place = (" --nail NAME", "nails") if (data.get("work") or {}).get("nails") else ("", "nail_xy")
        command = f"toolee calibrate nail --camera --station {path}{nail} --bars-mm X Y --thickness-mm T --write"
        yield OpenFields("work", (place, "stand_height"), command, typed=False, note="more exactly")
