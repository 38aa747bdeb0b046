"""The symmetry fix: the spin about a symmetric end effector's axis, taken from the hand that holds the tool.

The cloud of a symmetric EE does not show the spin about its axis; the hand does, because the tool is roughly fixed in
it. Only the twist about the axis is replaced (swing-twist decomposition), never the axis itself, and only as far as the
cloud's own evidence for the spin is weaker than the hand's.
"""

from __future__ import annotations

import cmath

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.perception.pose.pooling import FREE_SPIN_VARIANCE, align
from toolee_robot.perception.pose.representation import rotation_matrix, twist_angles
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind


def fix_spin(
    R: Array, R_prior: Array, group: SymmetryGroup, variance: float, prior_variance: float
) -> tuple[Array, float]:
    """Move the spin of a rotation toward the prior's.

    Both spins are combined like von Mises directions weighted by their precision, so that a free spin (variance pi^2/3)
    has no weight. For a C2 group the member of the orbit nearest to the prior is taken; without symmetry R is
    unchanged.

    Args:
        R: Estimated orientation of the EE, 3x3.
        R_prior: Orientation of the EE that the hand suggests, 3x3, in the same frame; only its twist relative to R
            about the group's axis is used.
        group: Symmetry group of the EE.
        variance: Variance [rad^2] of R's spin.
        prior_variance: Variance [rad^2] of the prior's spin.

    Returns:
        The rotation with the combined spin, 3x3, and the variance [rad^2] of that spin.
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
    """Set the rotational variance of a covariance about an axis.

    Args:
        covariance: 6x6, position [m] then rotation vector [rad].
        axis: Unit vector (3,) in the covariance's axes.
        variance: New variance [rad^2] about the axis, uncorrelated with everything else.

    Returns:
        The new covariance, 6x6.
    """
    P = np.eye(6)
    P[3:, 3:] -= np.outer(axis, axis)
    result = P @ covariance @ P
    result[3:, 3:] += variance * np.outer(axis, axis)
    return result
