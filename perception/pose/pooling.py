"""Pooling: from K candidate poses to one pose with a covariance; and the spin, if the hand knows it better.

The mean of candidates that flip between two symmetric readings lies between them. So the candidates are compared modulo
the EE's symmetry group, the densest mode is found, and only its members enter a robust mean. The cloud of a symmetric
EE does not show the spin about its axis; the hand does. Only the twist about the axis is replaced (swing-twist
decomposition), and only as far as the cloud's own evidence for it is weaker than the hand's.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose.representation import rotation_matrix, rotation_vectors, rotations_about, twist_angles
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind

FREE_SPIN_VARIANCE = np.pi**2 / 3
"""Variance [rad^2] of an unobserved angle: uniform on (-pi, pi)."""

MODE_ANGLE = np.deg2rad(25.0)
"""Candidates within this angle [rad], modulo the group, belong to one mode."""
MODE_DISTANCE = 0.015
"""Candidates within this distance [m] belong to one mode."""
_BANDWIDTH_ANGLE = np.deg2rad(6.0)
"""Bandwidth [rad] of the density estimate."""
_BANDWIDTH_DISTANCE = 0.003
"""Bandwidth [m] of the density estimate."""


@dataclass(frozen=True)
class SigmaScale:
    """Calibration factors on the pooled standard deviations, fitted to the errors on held-out tools.

    Attributes:
        position: Factor on the position's sigma.
        angle: Factor on the rotation's sigma.
    """

    position: float = 1.0
    angle: float = 1.0


@dataclass(frozen=True)
class Pooled:
    """The pooled pose.

    Attributes:
        X: Pose, 4x4, in the candidates' frame.
        covariance: 6x6, position [m] then rotation vector [rad], axes of the candidates' frame.
        modes: Masses of the modes (sum 1), largest first.
        spread_position: RMS deviation [m] of the position inside of the main mode.
        spread_angle: RMS deviation [rad] of the rotation inside of the main mode, modulo the group.
        spin_variance: Variance [rad^2] about the symmetry axis, or about z where there is none.
    """

    X: Array
    covariance: Array
    modes: tuple[float, ...]
    spread_position: float
    spread_angle: float
    spin_variance: float


def pool(
    Xs: Array,
    group: SymmetryGroup,
    sigma_position: float = 0.0,
    sigma_axis: float = 0.0,
    sigma_spin: float = 0.0,
    spin_observable: float = 1.0,
    scale: SigmaScale | None = None,
) -> Pooled:
    """Pool candidate poses modulo a symmetry group.

    Args:
        Xs: Candidate poses, (K, 4, 4).
        group: Symmetry group of the EE.
        sigma_position: The network's predicted position error [m].
        sigma_axis: Its predicted error [rad] of the z axis's direction.
        sigma_spin: Its predicted error [rad] of the spin about z.
        spin_observable: Probability that the view shows the spin; only matters for a continuous group, whose spin
            variance goes to pi^2/3 where the spin is unobserved.
        scale: Calibration factors; None: 1.

    Returns:
        The pooled pose. Its covariance is the mean of the candidates' scatter and the predicted one, scaled.
    """
    scale = scale or SigmaScale()
    R, p = Xs[:, :3, :3], Xs[:, :3, 3]
    angle = pairwise_angles(R, group)
    distance = _lengths(p[:, None] - p)
    density = np.exp(-0.5 * ((angle / _BANDWIDTH_ANGLE) ** 2 + (distance / _BANDWIDTH_DISTANCE) ** 2)).sum(1)
    members, modes = _modes(angle, distance, density)
    centre = int(members[np.argmax(density[members])])

    continuous = group.kind is SymmetryKind.CINF
    symmetry_axis = np.asarray(group.axis)
    aligned = align(R[members], R[centre], group)
    R_mean = R[centre]
    positions = p[members]
    p_mean = _median(positions)
    weight = np.ones(len(members))
    # No member is far from the centre, so that the vectors of the differences are well defined.
    w, dp = rotation_vectors(aligned @ R_mean.T), positions - p_mean
    for _ in range(3):
        # Cauchy weights over both deviations, scaled by their medians.
        w2, dp2 = np.vecdot(w, w), np.vecdot(dp, dp)
        weight = 1 / (1 + (w2 / (_median(w2) + 1e-6) + dp2 / (_median(dp2) + 1e-9)) / 4)
        weight /= weight.sum()
        R_mean = rotation_matrix(weight @ w) @ R_mean
        p_mean = p_mean + weight @ dp
        w, dp = rotation_vectors(aligned @ R_mean.T), positions - p_mean
    scatter_w = (w * weight[:, None]).T @ w
    scatter_p = (dp * weight[:, None]).T @ dp

    axis = R_mean @ symmetry_axis
    spin_variance = sigma_spin**2
    if continuous:
        twist = twist_angles(R_mean.T @ R[members], symmetry_axis)
        resultant = complex(weight @ np.exp(1j * twist))
        R_mean = R_mean @ rotation_matrix(cmath.phase(resultant) * symmetry_axis)
        seen = min(max(-2 * math.log(max(abs(resultant), 1e-6)), sigma_spin**2), FREE_SPIN_VARIANCE)
        spin_variance = spin_observable * seen + (1 - spin_observable) * FREE_SPIN_VARIANCE

    covariance = np.zeros((6, 6))
    covariance[:3, :3] = scale.position**2 * 0.5 * (scatter_p + sigma_position**2 * np.eye(3))
    if continuous:
        along = axis[:, None] * axis
        P = np.eye(3) - along
        swing = P @ scatter_w @ P + sigma_axis**2 * P
        covariance[3:, 3:] = scale.angle**2 * 0.5 * swing + spin_variance * along
    else:
        predicted = R_mean * [sigma_axis**2, sigma_axis**2, sigma_spin**2] @ R_mean.T
        covariance[3:, 3:] = scale.angle**2 * 0.5 * (scatter_w + predicted)
        spin_variance = float(R_mean[:, 2] @ covariance[3:, 3:] @ R_mean[:, 2])
    return Pooled(
        transform(R_mean, p_mean),
        covariance,
        modes,
        math.sqrt(np.trace(scatter_p)),
        math.sqrt(np.trace(scatter_w)),
        float(spin_variance),
    )


def pairwise_angles(R: Array, group: SymmetryGroup) -> Array:
    """Angles between rotations modulo a symmetry group.

    Args:
        R: Rotations (K, 3, 3).
        group: Symmetry group.

    Returns:
        (K, K) [rad].
    """
    if group.kind is SymmetryKind.CINF:
        axes = R @ np.asarray(group.axis)
        return 2 * np.arcsin(np.minimum(_lengths(axes[:, None] - axes) / 2, 1))
    # The chord |A - B|_F = 2 sqrt(2) sin(angle / 2) is accurate near 0, where arccos of the trace is not.
    flat = R.reshape(-1, 1, 9)
    chords = [_lengths((R @ g).reshape(-1, 9) - flat) for g in group.elements()]
    return 2 * np.arcsin(np.minimum(np.minimum.reduce(chords) / math.sqrt(8), 1))


def align(R: Array, R_reference: Array, group: SymmetryGroup) -> Array:
    """Choose from each rotation's orbit the member closest to a reference: `SymmetryGroup.canonical` for a batch.

    Args:
        R: Rotations (K, 3, 3).
        R_reference: Reference, 3x3.
        group: Symmetry group.

    Returns:
        Rotations (K, 3, 3).
    """
    if group.kind is SymmetryKind.CINF:
        axis = np.asarray(group.axis)
        twist = twist_angles(np.swapaxes(R, 1, 2) @ R_reference, axis)
        return R @ rotations_about(axis, twist)
    orbit = np.stack([R @ g for g in group.elements()])
    best = np.einsum("gkij,ij->gk", orbit, R_reference).argmax(0)
    return orbit[best, np.arange(len(R))]


def _lengths(x: Array) -> Array:
    """Norms of vectors (..., D); faster than `np.linalg.norm` for small arrays."""
    return np.sqrt(np.vecdot(x, x))


def _median(x: Array) -> Array:
    """Median along the first axis of a few finite numbers; ten times as fast as `np.median`, which checks for NaN."""
    ordered = np.sort(x, axis=0)
    return 0.5 * (ordered[(len(x) - 1) // 2] + ordered[len(x) // 2])


def _modes(angle: Array, distance: Array, density: Array) -> tuple[NDArray[np.intp], tuple[float, ...]]:
    """Indices of the members of the heaviest mode, and the masses of all modes, heaviest first."""
    close = (angle < MODE_ANGLE) & (distance < MODE_DISTANCE)
    left = np.ones(len(angle), dtype=bool)
    found = []
    while left.any():
        seed = int(np.argmax(np.where(left, density, -1.0)))
        member = close[seed] & left
        member[seed] = True
        found.append(np.flatnonzero(member))
        left &= ~member
    found.sort(key=len, reverse=True)
    return found[0], tuple(len(m) / len(angle) for m in found)


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
