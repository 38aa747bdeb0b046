"""JSON files and checksums of a data set; SHA256SUMS is written last: a folder that has it is whole."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from toolee_robot.errors import AssetError, words_of
from toolee_robot.runtime.files import write_atomic

SUMS = "SHA256SUMS"


def write_sums(folder: Path, sums: dict[str, str]) -> None:
    """Write the SHA256SUMS of a folder atomically, as `sha256sum -c` reads it.

    Args:
        folder: The folder.
        sums: Path in the folder -> SHA-256, hexadecimal.
    """
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
    write_atomic(folder / SUMS, text.encode())


def read_sums(folder: Path) -> dict[str, str]:
    """Read the SHA256SUMS of a folder.

    Args:
        folder: The folder.

    Returns:
        Path in the folder -> SHA-256, hexadecimal.

    Raises:
        AssetError: The file is missing, unreadable, or not a list of checksums.
    """
    try:
        lines = (folder / SUMS).read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise AssetError(f"cannot read {folder / SUMS}: {words_of(error)}") from error
    sums = {line[66:]: line[:64] for line in lines if len(line) > 66 and line[64:66] == "  "}
    if len(sums) != len(lines) or not sums:
        raise AssetError(f"{folder / SUMS} is not a list of checksums")
    return sums


def json_by_line(entries: dict[str, Any]) -> bytes:
    """A JSON object with one entry per line, for readable files and diffs."""
    lines = [f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in entries.items()]
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        AssetError: The file is missing or not valid JSON; the message names it.
    """
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise AssetError(
            f"cannot read {path}: {words_of(error)}; delete its scene and generate the data set again"
        ) from error
