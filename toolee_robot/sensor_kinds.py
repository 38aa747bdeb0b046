"""The kinds of depth camera that `render.depth_sensors` models, apart from it: names need no renderer."""

from __future__ import annotations

from typing import Literal, get_args

SensorKind = Literal[
    "time-of-flight", "time-of-flight-lab", "structured-light", "active-stereo", "filled-stereo", "mixed"
]
"""time-of-flight: noise and lost outlines alone. time-of-flight-lab: with systematic errors, holes and registration.
structured-light, active-stereo: see `render.triangulation`. filled-stereo: holes filled by the driver. mixed:
one of them, drawn for each image."""
KINDS: tuple[SensorKind, ...] = get_args(SensorKind)
"""All of them."""
