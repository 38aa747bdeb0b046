"""Which code runs: version and, from a checkout, commit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import toolee_robot


def code_version() -> str:
    """The package's version and, from a git checkout, its commit.

    Returns:
        Such as "0.1.0" or "0.1.0 a1b2c3d4e5f6", with "-dirty" appended where tracked files differ from the commit.
    """
    version = toolee_robot.__version__
    folder = Path(toolee_robot.__file__).parent
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12", "--match="]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version} {found.stdout.strip()}"
