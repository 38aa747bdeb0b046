"""The symmetry fix: the spin about a symmetric EE's axis, taken from the hand that holds the tool.

The cloud of a symmetric EE cannot tell the spin about its axis; the hand can, because the tool is roughly fixed in it.
Only the twist about the axis is replaced (swing-twist decomposition), never the axis itself, and only as far as the
cloud's own evidence for the spin is weaker than the hand's.
"""

from __future__ import annotations

import cmath

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.perception.pose.pooling import FREE_SPIN_VARIANCE, align
from toolee_robot.perception.pose.rotations import rotation_matrix, twist_angles
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind


def fix_spin(
    R: Array, R_prior: Array, group: SymmetryGroup, variance: float, prior_variance: float
) -> tuple[Array, float]:
    """The rotation R (3, 3) with its spin moved toward the prior's, and the spin's variance [rad^2] afterwards.

    R_prior: 3x3, the EE's orientation as the hand suggests it, same frame as R; only its twist relative to R about the
    group's axis is used. variance, prior_variance [rad^2] of the two spins: they combine like von Mises directions, so
    that a free spin (pi^2/3) has no weight. A C2 group picks the member of the orbit nearest to the prior; no group: R.
    """
    if group.kind is SymmetryKind.NONE:
        return R, variance
    if group.kind is SymmetryKind.C2:
        return align(R[None], R_prior, group)[0], variance
    axis = np.asarray(group.axis)
    delta = float(twist_angles((R.T @ R_prior)[None], axis)[0])
    seen, hand = (max(1 / max(v, 1e-9) - 1 / FREE_SPIN_VARIANCE, 0.0) for v in (variance, prior_variance))
    total = seen + cmath.rect(hand, delta)
    return R @ rotation_matrix(cmath.phase(total) * axis), 1 / (abs(total) + 1 / FREE_SPIN_VARIANCE)


def with_spin_variance(covariance: Array, axis: Array, variance: float) -> Array:
    """The 6x6 covariance with the rotation's variance about `axis` (3,) replaced and uncorrelated with the rest."""
    P = np.eye(6)
    P[3:, 3:] -= np.outer(axis, axis)
    result = P @ covariance @ P
    result[3:, 3:] += variance * np.outer(axis, axis)
    return result
