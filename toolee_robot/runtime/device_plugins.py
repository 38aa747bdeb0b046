"""Drivers that other packages bring: entry points of the group `toolee_robot.devices`.

A package of a lab names its drivers in its own pyproject.toml, and station files then name them like this project's:

    [project.entry-points."toolee_robot.devices"]
    "camera.our_camera" = "our_lab.cameras:open_stream"
    "hand.our_hand" = "our_lab.hands:open_hand"
    "hand_model.our_hand" = "our_lab.hands:OUR_HAND"
"""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any

from toolee_robot.errors import ConfigError

GROUP = "toolee_robot.devices"
"""Name of the group of entry points."""


def installed(kind: str) -> dict[str, EntryPoint]:
    """The drivers of a kind that installed packages bring.

    Args:
        kind: Kind of device, `camera` or `hand`; or `hand_model`.

    Returns:
        Their entry points, by the name that a station file gives.
    """
    found = (entry for entry in _entries(tuple(sys.path)) if entry.name.startswith(f"{kind}."))
    return {entry.name.removeprefix(f"{kind}."): entry for entry in found}


@cache
def _entries(path: tuple[str, ...]) -> EntryPoints:  # noqa: ARG001
    """What packages on this search path name: to read what all of them say takes long, and each question asks."""
    return entry_points(group=GROUP)


def load(entry: EntryPoint) -> Any:
    """Import what an entry point names.

    Args:
        entry: The entry point.

    Returns:
        What it names.

    Raises:
        ConfigError: It cannot be imported.
    """
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        source = entry.dist.name if entry.dist is not None else "an installed package"
        message = f"{source} names the driver {entry.name} as {entry.value}, which cannot be imported: {error}"
        raise ConfigError(message) from error
