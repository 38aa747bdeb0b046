"""The tracking error of a position-controlled joint that lags behind its commands."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array

TAIL = 1.1
"""How far back the commands reach that a reading may answer to, in lags. One that a servo smooths to the first order
answers to still older ones: where its time constant is the whole lag, a transfer at full speed leaves those of one lag
by 57 mrad, and those of 1.1 by 49 (computed at 125 Hz, where 50 stop the arm)."""


def tracking_error(sent: Array, commanded: Array, seen: float, q: Array, lag: float) -> float:
    """Distance of a reading from all the commands that it may answer to.

    Those are the commands sent from `TAIL` lags before the reading on, and the one in force then: a servo that delays
    the path by no more is between them, and how fast the arm moves does not matter.

    Args:
        sent: When each command was sent, increasing, (n,) [s].
        commanded: The commands, (n, 6) [rad].
        seen: When the reading was received [s].
        q: The measured joint positions, (6,) [rad].
        lag: Upper bound of the lag [s].

    Returns:
        The distance of the joint that is furthest outside its range of commands [rad]; 0 before the first command.
    """
    i, j = np.searchsorted(sent, (seen - TAIL * lag, seen))
    if j == 0:
        return 0.0
    due = commanded[max(i - 1, 0) : j]
    return float(max(np.max(q - due.max(axis=0)), np.max(due.min(axis=0) - q), 0.0))
