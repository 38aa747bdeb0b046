"""`measured.yaml` beside a station file: what programs measure, so that no program edits what a person wrote."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from toolee_robot.errors import ConfigError
from toolee_robot.frames import BaseFrame
from toolee_robot.runtime.yaml_files import YamlLines, read_yaml
from toolee_robot.station.head import FRAME, to_base
from toolee_robot.station.robot import ArmLimits, ServoConfig
from toolee_robot.station.schema import StationField, record_fields
from toolee_robot.station.work import WorkConfig

COMMANDS: Mapping[str, str] = {
    "arm.calibration": "toolee doctor",
    "calibration.record": "toolee calibrate camera",
    "servo.gain": "toolee arm lag",
    "servo.lookahead": "toolee arm lag",
    "servo.lag": "toolee arm lag",
    "work.nail_xy": "toolee calibrate nail",
    "work.stand_height": "toolee calibrate nail",
    "work.block_xy": "toolee calibrate nail",
    "work.wood_rise": "toolee calibrate nail",
    "work.nails": "toolee calibrate nail --nail NAME",
}
"""What it may hold, and the command that measures it."""
MOVED = 0.1
"""Distance of a measured place from the one that a person gives, over which one of the two is old or wrong [m]."""


def measured_path(station: Path) -> Path:
    """Name the file of what programs measured.

    Args:
        station: The station file.

    Returns:
        The file beside it: `measured.yaml` of `lab.yaml`, and `NAME.measured.yaml` of `NAME.yaml`.
    """
    return station.with_name("measured.yaml" if station.stem == "lab" else f"{station.stem}.measured.yaml")


def read_measured(station: Path) -> dict[str, Any]:
    """Read what programs measured for a station.

    Args:
        station: The station file.

    Returns:
        Sections with their fields, the positions in `base`; empty where nothing was measured.

    Raises:
        ConfigError: The file cannot be read, or holds what no program writes.
    """
    path = measured_path(station)
    if not path.is_file():
        return {}
    data = read_yaml(path, "file of measured values") or {}
    measured = {name: value for name, value in data.items() if name != FRAME} if isinstance(data, dict) else {"": data}
    if wrong := [*_wrong(measured, path)]:
        raise ConfigError(f"{path} was changed by hand: {'; '.join(wrong)}")
    return measured


def _wrong(measured: dict[str, Any], path: Path) -> Iterator[str]:
    known: dict[str, StationField] = {}
    for record, section in ((ArmLimits, "arm"), (ServoConfig, "servo"), (WorkConfig, "work")):
        known |= {field.name: field for field in record_fields(record, (section,))}
    lines = YamlLines(path)
    for section, values in measured.items():
        for name, value in values.items() if isinstance(values, dict) else [("", values)]:
            field, where = f"{section}.{name}", lines.told((section, name))
            if field not in COMMANDS:
                yield f"{field} ({where}) is not measured by a command: give it in the station file"
            elif field == "work.nails":
                if not isinstance(value, list) or not all(isinstance(nail, dict) and "name" in nail for nail in value):
                    yield f"{field} ({where}): each nail needs a name and what was measured of it"
            elif field in known:
                try:
                    TypeAdapter(known[field].hint).validate_python(value)
                except ValidationError as error:
                    told = error.errors()[0]
                    text = told.get("ctx", {}).get("error", told["msg"])
                    yield f"{field} ({where}): {text}; measure it again by `{COMMANDS[field]} --write`"


def with_measured(data: dict[str, Any], measured: dict[str, Any], station: Path) -> dict[str, Any]:
    """Take what programs measured instead of what a station file says.

    Args:
        data: What the station file holds.
        measured: What programs measured, from `read_measured`.
        station: The file.

    Returns:
        The data with the measured fields; the positions of both are in the file's frame.

    Raises:
        ConfigError: A place was measured far from where the file has it (`config.measured_place`).
    """
    frame = data.get(FRAME)
    measured = to_base(measured, BaseFrame(frame) if frame in list(BaseFrame) else BaseFrame.BASE_LINK)
    merged = {**data}
    for section, values in measured.items():
        typed = data.get(section)
        typed = dict(typed) if isinstance(typed, dict) else {}
        if section == "work":
            _check_moved(typed, values, station)
            values = _with_nails(typed, values)
        merged[section] = {**typed, **values}
    if FRAME not in merged and "work" in measured:
        merged[FRAME] = BaseFrame.BASE_LINK.value
    return merged


def _with_nails(typed: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    if "nails" not in values:
        return values
    located = {nail["name"]: nail for nail in values["nails"]}
    nails = typed.get("nails")
    nails = [nail for nail in nails if isinstance(nail, dict)] if isinstance(nails, list) else []
    return {**values, "nails": [{**nail, **located.get(nail.get("name"), {})} for nail in nails]}


def _check_moved(typed: dict[str, Any], measured: dict[str, Any], station: Path) -> None:
    pairs: list[tuple[str, Any, Any]] = [
        (name, typed.get(name), measured.get(name)) for name in ("nail_xy", "stand_height")
    ]
    located = {nail["name"]: nail.get("xy") for nail in measured.get("nails", ())}
    nails = typed.get("nails")
    for nail in nails if isinstance(nails, list) else ():
        if isinstance(nail, dict):
            pairs.append((f"nails, {nail.get('name')}: xy", nail.get("xy"), located.get(nail.get("name"))))
    for name, by_hand, by_program in pairs:
        try:
            one, other = (point if isinstance(point, list) else [point] for point in (by_hand, by_program))
            apart = math.dist(one, other)
        except (TypeError, ValueError):
            continue  # one is not given, or is none, which is told elsewhere
        if apart > MOVED:
            raise ConfigError(
                f"work.{name}: {station} says {by_hand}, {measured_path(station).name} beside it {by_program}, "
                f"{apart:.2f} m apart. Correct the station file. If the block was moved, delete the measured "
                "`work`, then run `toolee calibrate nail --write` again",
                code="config.measured_place",
            )
