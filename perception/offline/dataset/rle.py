"""COCO's run-length encoding of masks, compressed counts included, in numpy. Cross-checked against pycocotools."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import UserError


def encode(mask: NDArray[np.bool_]) -> dict[str, object]:
    """{"size": [H, W], "counts": text} of a mask (H, W): runs of 0 and 1, column by column."""
    height, width = mask.shape
    columns = np.flatnonzero(mask.any(axis=0))
    first, end = (columns[0], columns[-1] + 1) if len(columns) else (0, 0)
    flat = np.ravel(mask[:, first:end], order="F")
    changes = first * height + np.flatnonzero(np.diff(flat, prepend=False, append=False))
    counts = np.diff(np.concatenate([[0], changes, [mask.size]])).tolist()
    if counts[-1] == 0:  # the last run of 1 reaches the end
        counts.pop()
    return {"size": [int(height), int(width)], "counts": _compressed(counts)}


def decode(rle: dict[str, object]) -> NDArray[np.bool_]:
    """Decode a mask.

    Args:
        rle: The mask as `encode` gives it: "size", (H, W), and "counts".

    Returns:
        The mask, (H, W).

    Raises:
        UserError: It is not a COCO run-length encoding.
    """
    try:
        height, width = (int(n) for n in rle["size"])  # type: ignore[attr-defined]
        counts = _expanded(str(rle["counts"]))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise UserError(f"not a COCO run-length encoding: {error!r}") from error
    if min(counts, default=0) < 0 or sum(counts) != height * width:
        raise UserError(f"the runs of a COCO mask cover {sum(counts)} pixels, not {height * width}")
    values = np.arange(len(counts)) % 2 == 1
    return np.repeat(values, counts).reshape((height, width), order="F")


def _compressed(counts: list[int]) -> str:
    """Compress run lengths to text, in a variant of LEB128.

    Each character holds 5 bits, counted from '0'; a sixth bit marks that more follow. From the fourth run on the
    difference to the run before the last is stored.
    """
    text = []
    for i, count in enumerate(counts):
        x = count - counts[i - 2] if i > 2 else count
        more = True
        while more:
            c = x & 0x1F
            x >>= 5
            more = x != -1 if c & 0x10 else x != 0
            text.append(chr((c | 0x20 if more else c) + 48))
    return "".join(text)


def _expanded(text: str) -> list[int]:
    counts: list[int] = []
    i = 0
    while i < len(text):
        x, k, more = 0, 0, True
        while more:
            c = ord(text[i]) - 48
            x |= (c & 0x1F) << (5 * k)
            more = bool(c & 0x20)
            i += 1
            k += 1
            if not more and c & 0x10:
                x |= -1 << (5 * k)
        if len(counts) > 2:
            x += counts[-2]
        counts.append(x)
    return counts
