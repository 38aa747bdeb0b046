"""Sizes that nothing in a station has: a number in another unit is noticed where it is entered."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

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
    return ""


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, list | tuple):
        for part in value:
            yield from _numbers(part)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)
