"""The version of a station file: the first field of a file that describes a lab."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_lines import YamlLines

FIELD = "version"
"""The station file's key that tells its version."""
VERSION = 2
"""The version that this program reads and writes. A file of version 1 tells none."""


def is_current(data: Any, path: Path) -> bool:
    """Tell whether a station file is of the version that this program reads.

    Args:
        data: What the file holds.
        path: The file, for the error.

    Returns:
        Whether it is; False for a file of version 1, which gives `version: 1` or none.

    Raises:
        ConfigError: It is of a version that this program does not know (`config.version_unknown`).
    """
    told = data.get(FIELD, 1) if isinstance(data, dict) else 1
    if isinstance(told, int) and not isinstance(told, bool) and told in (1, VERSION):
        return told == VERSION
    where = YamlLines(path).told([FIELD])
    raise ConfigError(
        f"{path}: {FIELD} {told!r} is unknown{f' ({where})' if where else ''}: this program reads version {VERSION}, "
        "and `toolee station upgrade` rewrites version 1; a newer file needs a newer toolee_robot",
        code="config.version_unknown",
    )


def check_current(data: Any, path: Path) -> None:
    """Refuse a station file that is not of the version that this program reads.

    Args:
        data: What the file holds.
        path: The file, for the error.

    Raises:
        ConfigError: It is of version 1 (`config.version_old`), or of an unknown one (`config.version_unknown`).
    """
    if not is_current(data, path):
        raise ConfigError(
            f"{path} is a station file of version 1: run `toolee station upgrade {path}`, which rewrites it once and "
            "names what it lacks",
            code="config.version_old",
        )
