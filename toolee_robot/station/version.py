"""The version of a station file: the first field of a file that describes a lab."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_lines import YamlLines

FIELD = "version"
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
        ConfigError: It is of the version before (`config.version_old`), or of one that this program does not know
            (`config.version_unknown`).
    """
    told = data.get(FIELD) if isinstance(data, dict) else None
    if told is None or (told == VERSION and not isinstance(told, bool)):
        return told is not None
    lines = YamlLines(path).told([FIELD])
    where = f" ({lines})" if lines else ""
    if told == BEFORE:
        raise ConfigError(
            f"{path} is a station file of version {BEFORE}{where}: run `toolee station upgrade {path}` once",
            code="config.version_old",
        )
    raise ConfigError(
        f"{path}: {FIELD} {told!r} is unknown{where}: this program reads version {VERSION}; version 1 is upgraded by "
        "toolee_robot 0.1 first, and a newer file needs a newer toolee_robot",
        code="config.version_unknown",
    )


def check_current(data: Any, path: Path) -> None:
    """Refuse a lab's station file that names no version.

    Args:
        data: What the file holds.
        path: The file, for the error.

    Raises:
        ConfigError: It names none or an older one (`config.version_old`), or an unknown one
            (`config.version_unknown`).
    """
    if not is_current(data, path):
        raise ConfigError(
            f"{path} names no version: its first field is `{FIELD}: {VERSION}`; `toolee station check {path}` says "
            "what else it needs",
            code="config.version_old",
        )
