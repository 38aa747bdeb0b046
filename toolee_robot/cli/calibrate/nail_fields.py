"""What a located nail, and the wood, are in the station file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.config import WorkConfig, read_station
from toolee_robot.frames import Array, BaseFrame, inverse


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
        Values by field, of `work` itself first (None), then of the nail among `work.nails`, as `set_fields` has them.
    """
    data = {} if path is None else read_station(path)
    R = inverse(BaseFrame(data.get("frame", BaseFrame.BASE_LINK)).X_base_this)[:3, :3]
    xy = _rounded(R @ entry)
    fields: dict[str, Any] = {"stand_height": round(_stand_height(work, name, entry, rise), 5)}
    if rise is not None:
        fields["wood_rise"] = _rounded(R @ np.array([*rise, 0.0]))
    if with_nail and work.nails:
        return [(None, fields), (("nails", name), {"xy": xy})]
    return [(None, fields | ({"nail_xy": xy} if with_nail else {}))]


def _rounded(v: Array) -> list[float]:
    return [round(float(value), 5) + 0.0 for value in v[:2]]


def _stand_height(work: WorkConfig, name: str, entry: Array, rise: Array | None) -> float:
    """Height of the stand with which the wood is where the nail meets it [m]: that below the middle of the block."""
    places = np.array([entry[:2] if nail.name == name else nail.xy for nail in work.all_nails])
    center = (places.min(axis=0) + places.max(axis=0)) / 2 if work.block_xy is None else np.array(work.block_xy)
    slope = np.array(work.wood_rise) if rise is None else rise
    return float(entry[2] + slope @ (center - entry[:2])) - work.block_size[2]
