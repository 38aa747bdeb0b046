"""JSON files with a hash over their content, which shows alteration."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, TypeVar

from toolee_robot.errors import ConfigError, words_of
from toolee_robot.runtime.files import read_json, write_atomic
from toolee_robot.runtime.yaml_files import to_record

SIGNATURE = "sha256"
"""The file's key that holds the hash."""
T = TypeVar("T")


def write_signed(path: Path, data: dict[str, Any]) -> str:
    """Sign and write.

    The signature is a hash: it shows alteration by mistake or by an editor, not by somebody who signs again.

    Args:
        path: The file; its folder exists.
        data: What JSON can hold, finite numbers only.

    Returns:
        The signature, hexadecimal.

    Raises:
        UserError: The file cannot be written.
    """
    signature = _signature(data)
    text = json.dumps({**data, SIGNATURE: signature}, indent=1, allow_nan=False)
    write_atomic(path, (text + "\n").encode())
    return signature


def read_signed(path: Path, kind: type[T], what: str) -> T:
    """Read a record and check its signature.

    Args:
        path: The file.
        kind: The record, a dataclass.
        what: What the file is, for the errors.

    Returns:
        The record, validated.

    Raises:
        ConfigError: It cannot be read (`config.unreadable`), was altered (`config.calibration_altered`), or is no valid
            record (`config.invalid`).
    """
    try:
        data = read_json(path)
    except (OSError, ValueError) as error:
        message = f"cannot read the {what} {path} that `toolee calibrate` writes: {words_of(error)}"
        raise ConfigError(message, code="config.unreadable") from error
    if not isinstance(data, dict) or SIGNATURE not in data:
        raise ConfigError(f"{path} is no {what}: name a file that `toolee calibrate` wrote", code="config.invalid")
    signature = data.pop(SIGNATURE)
    if signature != _signature(data):
        raise ConfigError(
            f"{path} was altered since it was written: nothing in it can be relied on; take the original, or calibrate "
            "again",
            code="config.calibration_altered",
        )
    return to_record(data, path, kind, what)


def _signature(data: dict[str, Any]) -> str:
    # As the file will be read: tuples are lists there.
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
