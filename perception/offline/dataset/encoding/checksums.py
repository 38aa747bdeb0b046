"""SHA256SUMS: the checksums of a folder's files, which are written last: a folder that has them is whole."""

from __future__ import annotations

from pathlib import Path

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
