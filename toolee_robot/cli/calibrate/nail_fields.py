"""What a located nail, and the wood, are in the station file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.frames import Array, BaseFrame, inverse
from toolee_robot.station import WorkConfig, read_station


def nail_fields(
    work: WorkConfig, name: str, entry: Array, rise: Array | None, path: Path | None, *, with_nail: bool
) -> list[tuple[tuple[str, str] | None, dict[str, Any]]]:
    """Compute the fields of `work` that say where a nail and the wood are.

    Args:
        work: The work as the station file has it.
        name: The nail's name.
        entry: Where its axis meets the wood, (3,) [m], `base`.
        rise: How the wood rises along x and y of `base`, (2,); None for what the file says.
        path: The station file, which says in which frame it gives positions; None for `base`.
        with_nail: Whether the nail's place was located, and not the wood alone.

    Returns:
        Values by field, of `work` itself first (None), then of the nail among `work.nails`, with its name.
        With a rise there is always a `block_xy`, here or in the file: the plane hangs on the middle of the block, and
        must not move with the next nail.
    """
    data = {} if path is None else read_station(path)
    R = inverse(BaseFrame(data.get("frame", BaseFrame.BASE_LINK)).X_base_this)[:3, :3]
    xy = _rounded(R @ entry)
    center = _center(work, name, entry)
    slope = np.array(work.wood_rise) if rise is None else rise
    height = float(entry[2] + slope @ (center - entry[:2])) - work.block_size[2]
    fields: dict[str, Any] = {"stand_height": round(height, 5)}
    if rise is not None:
        if work.block_xy is None:
            fields["block_xy"] = _rounded(R @ np.array([*center, 0.0]))
        fields["wood_rise"] = _rounded(R @ np.array([*rise, 0.0]))
    if with_nail and work.nails:
        return [(None, fields), (("nails", name), {"xy": xy})]
    return [(None, fields | ({"nail_xy": xy} if with_nail else {}))]


def _rounded(v: Array) -> list[float]:
    return [round(float(value), 5) + 0.0 for value in v[:2]]


def _center(work: WorkConfig, name: str, entry: Array) -> Array:
    """Middle of the block, (2,) [m], `base`: where the file has it, or between the nails with this one where it is."""
    if work.block_xy is not None:
        return np.array(work.block_xy)
    places = np.array([entry[:2] if nail.name == name else nail.xy for nail in work.all_nails])
    return np.asarray((places.min(axis=0) + places.max(axis=0)) / 2)
