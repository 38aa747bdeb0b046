"""The first fields of a station file: its version, and the frame of its positions with their conversion to `base`."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scipy.spatial.transform import Rotation

from toolee_robot.errors import ConfigError
from toolee_robot.frames import HALF_TURN, BaseFrame
from toolee_robot.runtime.yaml_files import YamlLines

VERSION_FIELD = "version"
"""The station file's key that tells its version."""
VERSION = 3
"""The version that this program reads and writes."""
BEFORE = 2
"""The version that `toolee station upgrade` takes."""


def is_current(data: Any, path: Path) -> bool:
    """Tell whether a station file is of the version that this program reads.

    Args:
        data: What the file holds.
        path: The file, for the error.

    Returns:
        Whether it is; False for a file that names no version.

    Raises:
        ConfigError: It is of the version before, or of one that this program does not know.
    """
    told = data.get(VERSION_FIELD) if isinstance(data, dict) else None
    if told is None or (told == VERSION and not isinstance(told, bool)):
        return told is not None
    lines = YamlLines(path).told([VERSION_FIELD])
    where = f" ({lines})" if lines else ""
    if told == BEFORE:
        raise ConfigError(
            f"{path} is a station file of version {BEFORE}{where}: run `toolee station upgrade {path}` once"
        )
    raise ConfigError(
        f"{path}: {VERSION_FIELD} {told!r} is unknown{where}: this program reads version {VERSION}. Upgrade version "
        "1 with toolee_robot 0.1 first. A newer file needs a newer toolee_robot"
    )


def check_current(data: Any, path: Path) -> None:
    """Refuse a lab's station file that names no version.

    Args:
        data: What the file holds.
        path: The file, for the error.

    Raises:
        ConfigError: It names none or an older one, or an unknown one.
    """
    if not is_current(data, path):
        raise ConfigError(
            f"{path} names no version. Begin it with `{VERSION_FIELD}: {VERSION}`; `toolee station check {path}` "
            "lists what else it needs"
        )


FRAME = "frame"
"""The station file's key that names the frame."""
POINTS = (
    ("arm", "up"),
    ("camera", "position"),
    ("camera", "target"),
    ("work", "nail_xy"),
    ("work", "block_xy"),
    ("work", "wood_rise"),
    ("work", "nail_lean"),
    ("scene", "table_center"),
    ("scene", "person_center"),
    ("scene", "handover_position"),
    ("scene", "handover_facing"),
)
"""Fields that hold a point or a direction in `base`: section and name."""
POSE = ("camera", "X_base_camera")
"""Section and field of the camera's pose, which `take_camera_pose` converts."""
BOX = ("scene", "workspace_lower", "workspace_upper")
"""Section and fields of the box that is axis-aligned in `base`."""
OBSTACLES = ("scene", "obstacles")
"""Section and field of the list of boxes, each with a centre and a rotation."""
NAILS = ("work", "nails")
"""Section and field of the list of nails, each with a place, and perhaps a lean."""


def take_frame(data: dict[str, Any]) -> BaseFrame:
    """Take the name of the frame out of a station file's data.

    Args:
        data: What the file holds; `frame` is removed.

    Returns:
        The frame; `base_link` where the file gives no position at all.

    Raises:
        ConfigError: The file gives a position and names no frame, or an unknown one, or half of the workspace.
    """
    given = list(_positions(data))
    value = data.pop(FRAME, None)
    if value is None:
        if not given:
            return BaseFrame.BASE_LINK
        raise ConfigError(
            f"the station file gives {', '.join(given)}, but not their frame. Add `frame: pendant_base` if they "
            "were read from the teach pendant (feature Base), or `frame: base_link` if they are ROS's. The two "
            "differ by half a turn about z"
        )
    if value not in list(BaseFrame):
        names = ", ".join(BaseFrame)
        raise ConfigError(f"frame: {value!r} is unknown: give one of {names}")
    frame = BaseFrame(value)
    section, lower, upper = BOX
    if frame is BaseFrame.PENDANT_BASE and sum(f"{section}.{name}" in given for name in (lower, upper)) == 1:
        raise ConfigError(
            f"give both or none of {section}.{lower} and {section}.{upper} in the frame {frame}, because half a "
            "turn swaps the corners"
        )
    return frame


def to_base(data: dict[str, Any], frame: BaseFrame) -> dict[str, Any]:
    """Convert a station file's positions to `base`.

    Args:
        data: What a valid file holds, without its frame; the pose of its camera is in `base` already.
        frame: The frame of its positions.

    Returns:
        The same with every given position in `base`; fields that are not given stay so.
    """
    if frame is BaseFrame.BASE_LINK:
        return data
    data = copy.deepcopy(data)
    for section, name in POINTS:
        if (data.get(section) or {}).get(name) is not None:
            data[section][name] = _turned(data[section][name])
    section, lower, upper = BOX
    if (box := data.get(section) or {}).keys() >= {lower, upper}:
        a, b = _turned(box[lower]), _turned(box[upper])
        box[lower], box[upper] = [b[0], b[1], a[2]], [a[0], a[1], b[2]]
    section, name = OBSTACLES
    for obstacle in (data.get(section) or {}).get(name) or ():
        obstacle["center"] = _turned(obstacle["center"])
        turned = Rotation.from_matrix(HALF_TURN[:3, :3]) * Rotation.from_rotvec(
            obstacle.get("rotation", (0.0, 0.0, 0.0))
        )
        obstacle["rotation"] = turned.as_rotvec().tolist()
    section, name = NAILS
    for nail in (data.get(section) or {}).get(name) or ():
        nail |= {name: _turned(nail[name]) for name in ("xy", "lean") if nail.get(name) is not None}
    return data


def _turned(point: Any) -> list[float]:
    x, y, *z = point
    return [0.0 - float(x), 0.0 - float(y), *z]


def _positions(data: dict[str, Any]) -> Iterator[str]:
    section, *corners = BOX
    for part, name in (*POINTS, POSE, OBSTACLES, NAILS, *((section, corner) for corner in corners)):
        if isinstance(fields := data.get(part), dict) and fields.get(name) is not None:
            yield f"{part}.{name}"
