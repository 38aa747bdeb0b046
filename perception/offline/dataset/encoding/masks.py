"""Pixels of masks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def pixels_of(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels of a mask, row by row.

    The same as np.nonzero, which takes ten times as long in two dimensions.

    Args:
        mask: The mask, (H, W).

    Returns:
        Rows (N,) and columns (N,).
    """
    rows, columns = np.divmod(np.flatnonzero(mask), mask.shape[1])
    return rows, columns
