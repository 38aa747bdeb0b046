"""Station files of real robots, in which nothing that describes a lab may have a simulated value; measured values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from toolee_robot.errors import ConfigError
from toolee_robot.frames import BaseFrame
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.yaml_files import YamlLines
from toolee_robot.station.cell import CAMERA, LOOK_AT, POSE_FIELD, CameraConfig, SceneConfig, ToolEnvelope
from toolee_robot.station.head import FRAME, check_current
from toolee_robot.station.job import StrikeConfig, check_enclosed
from toolee_robot.station.measured_file import measured_path, read_measured, with_measured
from toolee_robot.station.robot import ArmLimits, HandConfig
from toolee_robot.station.schema import required
from toolee_robot.station.station import StationConfig, read_station, read_typed, to_station
from toolee_robot.station.work import SIZES, WorkConfig
from toolee_robot.types import MOUNT

MEASURED: Mapping[str, tuple[str, ...]] = {
    "arm": tuple(required(ArmLimits)),
    "hand": (*required(HandConfig), "weighed"),
    "scene": tuple(required(SceneConfig)),
    "camera": ("position", "target", *required(CameraConfig)),
    "work": tuple(required(WorkConfig)),
    "tool_envelope": tuple(required(ToolEnvelope)),
    "strike": tuple(required(StrikeConfig)),
}
"""Fields that describe a lab and nobody else's, so that they have no default: section of the station file, and names. A
calibration is none of them: without one a station is uncalibrated, which every job refuses."""
HEAD = (
    "# Values that commands measured for {station}; a command with --write replaces its part. Positions are in "
    "base_link.\n# To drop a measurement, delete its section.\n"
)


def unmeasured(path: Path) -> list[str]:
    """List what a station file leaves out of what a lab must measure.

    Args:
        path: The station file.

    Returns:
        Names of the fields, such as `camera.position`, in the order of `MEASURED`.

    Raises:
        ConfigError: The file cannot be read.
    """
    return _missing(read_station(path))


def load_lab_station(path: Path, *, complete: bool = True) -> StationConfig:
    """Load the station file of a real robot.

    Args:
        path: The file, as for `load_station`, with `version: 3` and every field of `MEASURED`.
        complete: Whether a file that leaves out some of them is refused.

    Returns:
        The validated configuration, its positions in `base`; its calibration is None where the file gives none.

    Raises:
        ConfigError: As `load_station`, or the file is of an older version, or leaves out what
            must be measured, or gives a size in another unit; the message
            names it and its line, or that of its section; or the tool is outside of its cylinders.
    """
    data = read_station(path)
    check_current(data, path)
    config = to_station(data, path)
    check_enclosed(config, path)
    if complete and (missing := _missing(data)):
        raise ConfigError(
            f"{path} is incomplete, and the simulated station's values must not stand in. Measure and give "
            f"{', '.join(missing)}{_lines(missing, path)}; `toolee station check {path}` says how"
        )
    return config if data.get("calibration") else replace(config, calibration=None)


def _missing(data: Any) -> list[str]:
    wanted = [(section, name) for section, names in MEASURED.items() for name in names]
    missing = [f"{section}.{name}" for section, name in wanted if _field(data, section, name) is None]
    if _field(data, "hand", "model") == MOUNT and "hand.weighed" in missing:
        missing.remove("hand.weighed")  # a mount's data say what it weighs
    unneeded = given_by_nails(_field(data, "work", "nails")) | given_by_pose(_field(data, CAMERA, POSE_FIELD))
    return [name for name in missing if name not in unneeded]


def _lines(missing: Sequence[str], path: Path) -> str:
    """The lines of the sections in which fields are missing, each once, and of fields that are given as null."""
    lines, told = YamlLines(path), dict[str, None]()
    for name in missing:
        if where := lines.told(name.split(".")):
            told[f"{name}: {where}" if where.startswith("line") else where] = None
    return f" ({', '.join(told)})" if told else ""


def given_by_nails(nails: Any) -> set[str]:
    """Tell which measured fields a list of nails makes unnecessary.

    Args:
        nails: The station file's `work.nails`; None or empty for none.

    Returns:
        Names of the fields that every nail of the list gives for itself, such as `work.nail_xy`.
    """
    of_each = {"nail_xy": "xy", "pilot_hole_diameter": "pilot_hole_diameter"} | {f"nail_{n}": n for n in SIZES}
    return {
        f"work.{name}"
        for name, field in of_each.items()
        if nails and all(isinstance(nail, dict) and nail.get(field) is not None for nail in nails)
    }


def given_by_pose(pose: Any) -> set[str]:
    """Tell which measured fields a pose of the camera makes unnecessary.

    Args:
        pose: The station file's `camera.X_base_camera`; None for none.

    Returns:
        Names of the fields, such as `camera.position`.
    """
    return set() if pose is None else {f"{CAMERA}.{name}" for name in LOOK_AT}


def _field(data: Any, section: str, name: str) -> Any:
    fields = data.get(section) if isinstance(data, dict) else None
    return fields.get(name) if isinstance(fields, dict) else None


def write_measured(path: Path, **sections: Mapping[str, Any]) -> Path:
    """Enter what a program measured for a station into `measured.yaml`; what was measured otherwise stays.

    Args:
        path: The station file; it is not changed.
        **sections: Fields by section, such as `servo={"lag": 0.034}`, positions in `base`. Of `work.nails` each record
            has the name of its nail.

    Returns:
        The file that was written, as a whole.

    Raises:
        ConfigError: The station would be refused with these values; nothing was written.
        UserError: The file cannot be written.
    """
    file, measured = measured_path(path), read_measured(path)
    for section, values in sections.items():
        before = measured.get(section, {})
        after = {**before, **values}
        if "nails" in after:
            named = {nail["name"]: nail for part in (before, values) for nail in part.get("nails", ())}
            after["nails"] = [*named.values()]
        measured[section] = after
    try:
        to_station(with_measured(read_typed(path), measured, path), path)
    except ConfigError as error:
        raise ConfigError(
            f"nothing was entered, because the station is refused with what was measured ({sections}). Correct the "
            f"field that does not fit, or measure again. {error}",
            code=error.code,
        ) from error
    whole = {FRAME: BaseFrame.BASE_LINK.value, **measured}
    text = HEAD.format(station=path.name) + yaml.safe_dump(whole, sort_keys=False, default_flow_style=None)
    write_atomic(file, text.encode())
    return file
