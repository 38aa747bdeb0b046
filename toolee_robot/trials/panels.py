"""Small diagrams side by side: shares of nails that are flush against something."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from toolee_robot.frames import Array
from toolee_robot.trials.statistics import Share

BLUE, RED = "#12609e", "#b3261e"
"""Colours of what is shown and of what it is compared with."""
_COLUMNS = 3


def panels(count: int) -> tuple[Figure, list[Axes]]:
    """Make diagrams with a common axis of shares.

    Args:
        count: Number of diagrams.

    Returns:
        The figure and its diagrams.
    """
    rows = -(-count // _COLUMNS)
    figure = Figure(figsize=(10.5, 2.8 * rows), layout="constrained")
    axes = list(figure.subplots(rows, _COLUMNS, squeeze=False, sharey=True).ravel())
    for i, ax in enumerate(axes):
        ax.set_ylim(-0.03, 1.03)
        ax.grid(alpha=0.3)
        ax.set_visible(i < count)
    for ax in axes[::_COLUMNS]:
        ax.set_ylabel("flush")
    return figure, axes[:count]


def rates(shares: Sequence[Share]) -> Array:
    """The shares as numbers, (n,)."""
    return np.array([s.hits / s.of for s in shares])


def errors(shares: Sequence[Share]) -> Array:
    """How far the ends of their intervals are below and above them, (2, n)."""
    y = rates(shares)
    return np.maximum([y - [s.low for s in shares], [s.high for s in shares] - y], 0.0)


def png(figure: Figure) -> bytes:
    """The figure as the content of a PNG file."""
    file = BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()
