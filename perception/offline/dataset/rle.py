"""COCO's run-length encoding of masks, compressed counts included, in numpy. Cross-checked against pycocotools."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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
