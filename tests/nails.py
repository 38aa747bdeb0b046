"""Several nails in one piece of wood."""

from __future__ import annotations

from dataclasses import replace

from toolee_robot.station import NailConfig, WorkConfig


def with_nails(work: WorkConfig, *nails: NailConfig) -> WorkConfig:
    """The work with these nails instead of those before, about the first of them."""
    return replace(work, nails=nails, nail_xy=nails[0].xy).only(nails[0].name)
