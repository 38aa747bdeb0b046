"""Sizes that nothing in a station has: a number in another unit is noticed where it is entered."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_lines import YamlLines
from toolee_robot.station.field_docs import field_docs

if TYPE_CHECKING:
    from toolee_robot.station.station import StationConfig

SECTIONS = ("arm", "hand", "scene", "camera", "work", "tool")
"""Sections of a station file whose sizes are looked at."""

LARGEST = {"[m]": (10.0, "millimetres"), "[rad]": (2.0 * np.pi, "degrees"), "[kg]": (50.0, "grams")}
"""Largest size in each unit, and what a larger number is taken for."""
SMALL = {
    "nail_diameter": 0.02,
    "nail_head_diameter": 0.05,
    "nail_length": 0.4,
    "nail_protrusion": 0.4,
    "pilot_hole_diameter": 0.02,
    "grip_radius": 0.1,
}
"""Largest size of what is small [m], by the field's name."""

FASTEST = {"acceleration": 100.0, "stop_acceleration": 100.0, "transfer_acceleration": 100.0, "yield_torque": 60.0}
"""Largest value of what no arm and no hand exceeds, in the field's own unit, by its name."""
HEAVIEST = 4.0
"""Largest mass of a hammer for one hand [kg]."""
LENSES = (0.3, 4.0)
"""Smallest and largest focal length, in widths of the image."""


def check_units(config: StationConfig, path: Path) -> None:
    """Refuse sizes that are in another unit, such as a camera at 950 m, and others that nothing has.

    Args:
        config: What a station file says.
        path: The file, for the message.

    Raises:
        ConfigError: A size is (`config.unit`); the message names it and its line.
    """
    records = [(name, getattr(config, name)) for name in SECTIONS if getattr(config, name) is not None]
    records += [(f"work.nails {nail.name}", nail) for nail in config.work.nails]
    records += [(f"scene.obstacles {obstacle.name}", obstacle) for obstacle in config.scene.obstacles]
    wrong = [
        f"{section}.{name}: {text}"
        for section, record in records
        for name, description in field_docs(type(record)).items()
        if (text := wrong_unit(name, description, getattr(record, name)))
    ]
    camera = config.camera
    for name in ("fx", "fy"):
        if not LENSES[0] <= getattr(camera, name) / camera.width <= LENSES[1]:
            wrong.append(
                f"camera.{name}: {getattr(camera, name)} px is no focal length of a {camera.width} px wide image"
            )
    if config.tool is not None and config.tool.mass is not None and config.tool.mass > HEAVIEST:
        wrong.append(f"tool.mass: {config.tool.mass} kg is no hammer for one hand")
    if wrong:
        raise ConfigError(f"{path}: {'; '.join(_with_lines(wrong, path))}", code="config.unit")


def _with_lines(wrong: list[str], path: Path) -> Iterator[str]:
    lines = YamlLines(path)
    for text in wrong:
        section, _, name = text.partition(":")[0].rpartition(".")
        where = lines.told((*section.split()[0].split("."), name))  # a nail of a list: the line of the list
        yield f"{text} ({where})" if where else text


def wrong_unit(name: str, text: str, value: Any) -> str:
    """Tell whether a value is in another unit.

    Args:
        name: Name of the field.
        text: Its description, which names the unit, such as `[m]`.
        value: The value, a number or several.

    Returns:
        What is wrong; empty for nothing.
    """
    numbers = list(_numbers(value))
    for unit, (largest, other) in LARGEST.items():
        most = SMALL.get(name, largest) if unit == "[m]" else largest
        if unit in text and numbers and max(map(abs, numbers)) > most:
            return f"{value} is no size in {unit}: that looks like {other}"
    if name in FASTEST and numbers and max(numbers) > FASTEST[name]:
        return f"{value} is more than any arm or hand has; the largest accepted is {FASTEST[name]:g}"
    return ""


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, list | tuple):
        for part in value:
            yield from _numbers(part)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)
