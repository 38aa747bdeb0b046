"""The frame in which a station file gives its positions, and their conversion to `base`."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

from scipy.spatial.transform import Rotation

from toolee_robot.errors import ConfigError
from toolee_robot.frames import HALF_TURN, BaseFrame

FIELD = "frame"
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
    value = data.pop(FIELD, None)
    if value is None:
        if not given:
            return BaseFrame.BASE_LINK
        raise ConfigError(
            f"the station file gives {', '.join(given)} and does not say in which frame: add `frame: pendant_base` if "
            "they were read from the teach pendant (feature Base), `frame: base_link` if they are ROS's; the two "
            "differ by half a turn about z",
            code="config.no_frame",
        )
    if value not in list(BaseFrame):
        names = ", ".join(BaseFrame)
        raise ConfigError(f"frame: {value!r} is unknown, give one of {names}", code="config.frame")
    frame = BaseFrame(value)
    section, lower, upper = BOX
    if frame is BaseFrame.PENDANT_BASE and sum(f"{section}.{name}" in given for name in (lower, upper)) == 1:
        raise ConfigError(
            f"{section}.{lower} and {section}.{upper}: give both or none in the frame {frame}, where the other's "
            "default is another corner",
            code="config.frame_box",
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
