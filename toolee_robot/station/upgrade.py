"""A station file of version 2 becomes one of version 3. To be deleted with the release after 0.2."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from toolee_robot.errors import UserError
from toolee_robot.runtime.files import written_whole
from toolee_robot.station.head import BEFORE, VERSION, VERSION_FIELD, check_current
from toolee_robot.station.measured import write_measured
from toolee_robot.station.measured_file import COMMANDS, measured_path
from toolee_robot.station.station import read_station, read_typed, to_station

MOVED = [name for name in COMMANDS if not name.startswith("work.")]
"""What leaves the station file: of the nail's place nobody can tell whether it was typed or measured."""


@dataclass(frozen=True)
class Upgraded:
    """What an upgrade did.

    Attributes:
        lines: It in words.
        data: What the station's files hold now.
    """

    lines: list[str]
    data: Any


def upgrade(path: Path) -> Upgraded:
    """Rewrite a station file of version 2.

    Args:
        path: The station file; one of version 3 stays as it is. Of a symbolic link, the file that it leads to.

    Returns:
        What was done.

    Raises:
        ConfigError: The file is invalid, or of another version; nothing was changed.
        UserError: A copy of an earlier upgrade is there, or the folder cannot be written.
    """
    data = read_typed(path)
    if not isinstance(data, dict) or data.get(VERSION_FIELD) != BEFORE:
        check_current(data, path)
        return Upgraded([f"{path} already has version {VERSION}: nothing was changed."], data)
    to_station({**data, VERSION_FIELD: VERSION}, path)  # a file that is wrong is corrected before it is rewritten
    measured: dict[str, dict[str, Any]] = {}
    for section, name in (field.split(".") for field in MOVED):
        if isinstance(data.get(section), dict) and data[section].get(name) is not None:
            measured.setdefault(section, {})[name] = data[section][name]
    place = path.resolve()
    kept = place.with_name(f"{place.name}.v{BEFORE}")
    if kept.exists():
        raise UserError(f"{kept} already exists: move it away, because it is not overwritten")
    text = place.read_text(encoding="utf-8")
    text = re.sub(rf"^{VERSION_FIELD}:(\s*){BEFORE}\b", rf"{VERSION_FIELD}:\g<1>{VERSION}", text, flags=re.M)
    wanted = {**data, VERSION_FIELD: VERSION}
    for section, fields in measured.items():
        wanted[section] = {name: value for name, value in data[section].items() if name not in fields}
    shorter = "".join(_without(text, measured))
    try:
        left = yaml.safe_load(shorter) != {name: value for name, value in wanted.items() if value != {}}
    except yaml.YAMLError:
        left = True
    shutil.copy(place, kept)
    with written_whole(place) as scratch:
        shutil.copy(place, scratch)  # its permissions
        scratch.write_text(text if left else shorter, encoding="utf-8")
    lines = [f"{path} now has version {VERSION}. The old file is {kept}."]
    if measured:
        write_measured(path, **measured)
        names = ", ".join(f"{section}.{name}" for section, fields in measured.items() for name in fields)
        lines.append(f"{measured_path(path).name} holds the measured values: {names}.")
        if left:
            lines.append(f"Delete them in {path} by hand: they could not be separated from the other text.")
    return Upgraded(lines, read_station(path))


def _without(text: str, moved: dict[str, dict[str, Any]]) -> Iterator[str]:
    """The lines of a file but for those of fields in block style, and of sections that are left without any."""
    gone: set[int] = set()
    root: Any = yaml.compose(text, yaml.SafeLoader)
    for key, section in root.value:
        names = moved.get(key.value, {})
        fields = {name.value: (name, value) for name, value in section.value} if names else {}
        whole = bool(fields) and set(fields) <= set(names)
        for begin, end in [(key, section.value[-1][1])] if whole else [fields[name] for name in names]:
            gone |= set(range(begin.start_mark.line, end.end_mark.line + 1))
    return (line for number, line in enumerate(text.splitlines(keepends=True)) if number not in gone)
