"""What a lab must measure: station files of real robots, in which nothing measured may have a simulated value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_lines import YamlLines
from toolee_robot.station import intrinsics_record
from toolee_robot.station.camera_pose import FIELD, LOOK_AT, SECTION
from toolee_robot.station.intrinsics_record import given_by_intrinsics
from toolee_robot.station.station import StationConfig, read_station, to_station
from toolee_robot.station.tool_enclosure import check_enclosed
from toolee_robot.station.version import check_current
from toolee_robot.station.work import SIZES
from toolee_robot.types import MOUNT

MEASURED: Mapping[str, tuple[str, ...]] = {
    "arm": ("model", "up"),
    "hand": ("model", "weighed"),
    "scene": (
        "home",
        "workspace_lower",
        "workspace_upper",
        "table_size",
        "table_center",
        "table_height",
        "person_center",
        "person_size",
        "handover_position",
        "handover_facing",
        "camera_size",
    ),
    "camera": ("position", "target", "fx", "fy", "cx", "cy", "width", "height"),
    "work": (
        "nail_xy",
        "stand_height",
        "stand_size",
        "block_size",
        "nail_diameter",
        "nail_length",
        "nail_head_diameter",
        "nail_protrusion",
        "wood_specific_gravity",
        "pilot_hole_diameter",
    ),
    "strike": ("speed",),
}
"""Fields that describe a lab and nobody else's: section of the station file, and names. The speed of the strikes is
among them since the simulation's is too fast for the first ones on a robot; a calibration is not: without one a station
is uncalibrated, which every job refuses."""


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
        path: The file, as for `load_station`, with `version: 2` and every field of `MEASURED`.
        complete: Whether a file that leaves out some of them is refused.

    Returns:
        The validated configuration, its positions in `base`; its calibration is None where the file gives none.

    Raises:
        ConfigError: As `load_station`, or the file is of version 1 (`config.version_old`), or leaves out what must be
            measured (`config.unmeasured`), or gives a size in another unit (`config.invalid`); the message names it and
            its line, or that of its section; or a tool that is outside of its cylinders (`config.tool_envelope`).
    """
    data = read_station(path)
    check_current(data, path)
    config = to_station(data, path)
    check_enclosed(config, path)
    if complete and (missing := _missing(data)):
        raise ConfigError(
            f"{path} leaves out what describes your station, and the simulated one's values would stand in for it: "
            f"measure and give {', '.join(missing)}{_lines(missing, path)}; `toolee station check {path}` says how",
            code="config.unmeasured",
        )
    return config if data.get("calibration") else replace(config, calibration=None)


def _missing(data: Any) -> list[str]:
    wanted = [(section, name) for section, names in MEASURED.items() for name in names]
    missing = [f"{section}.{name}" for section, name in wanted if _field(data, section, name) is None]
    if _field(data, "hand", "model") == MOUNT and "hand.weighed" in missing:
        missing.remove("hand.weighed")  # a mount's data say what it weighs
    unneeded = given_by_nails(_field(data, "work", "nails")) | given_by_pose(_field(data, SECTION, FIELD))
    unneeded |= given_by_intrinsics(_field(data, SECTION, intrinsics_record.FIELD))
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
    return set() if pose is None else {f"{SECTION}.{name}" for name in LOOK_AT}


def _field(data: Any, section: str, name: str) -> Any:
    fields = data.get(section) if isinstance(data, dict) else None
    return fields.get(name) if isinstance(fields, dict) else None
