"""From K candidate poses to one pose with a covariance: quotient by the symmetry group, cluster, robust mean.

A plain mean of candidates that flip between two symmetric readings lands between them; here every candidate is first
compared modulo the EE's group, the densest mode is found, and only its members are averaged.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose.rotations import rotation_matrix, rotation_vectors, rotations_about, twist_angles
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind

FREE_SPIN_VARIANCE = np.pi**2 / 3
"""[rad^2] variance of an angle of which nothing is known: uniform on (-pi, pi)."""

MODE_ANGLE = np.deg2rad(25.0)
MODE_DISTANCE = 0.015
_BANDWIDTH_ANGLE = np.deg2rad(6.0)
_BANDWIDTH_DISTANCE = 0.003


@dataclass(frozen=True)
class SigmaScale:
    """How much the raw spread and the network's sigma must be scaled to match the errors seen on held-out tools."""

    position: float = 1.0
    angle: float = 1.0


@dataclass(frozen=True)
class Pooled:
    """X: 4x4. covariance: 6x6, position [m] then rotation vector [rad], axes of the frame X is in. modes: masses of
    the modes, largest first. spread_position [m], spread_angle [rad]: RMS deviation inside of the main mode; the
    angle modulo the group. spin_variance [rad^2] about the symmetry axis (about z where there is none).
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
    """Pool candidates Xs (K, 4, 4) modulo `group`.

    sigma_*: the network's own error prediction ([m], [rad]: direction of the z axis, spin about it), averaged with the
    spread and scaled by the calibration `scale`. spin_observable: probability that the view tells the spin; it only
    matters for a continuous group, whose spin variance goes to pi^2/3 where nothing tells it.
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
    """(K, K) angles [rad] between rotations (K, 3, 3) modulo the group."""
    if group.kind is SymmetryKind.CINF:
        axes = R @ np.asarray(group.axis)
        return 2 * np.arcsin(np.minimum(_lengths(axes[:, None] - axes) / 2, 1))
    # The chord |A - B|_F = 2 sqrt(2) sin(angle / 2) is accurate near 0, where arccos of the trace is not.
    flat = R.reshape(-1, 1, 9)
    chords = [_lengths((R @ g).reshape(-1, 9) - flat) for g in group.elements()]
    return 2 * np.arcsin(np.minimum(np.minimum.reduce(chords) / math.sqrt(8), 1))


def align(R: Array, R_reference: Array, group: SymmetryGroup) -> Array:
    """`SymmetryGroup.canonical` for a batch (K, 3, 3): the member of each orbit closest to R_reference (3, 3)."""
    if group.kind is SymmetryKind.CINF:
        axis = np.asarray(group.axis)
        twist = twist_angles(np.swapaxes(R, 1, 2) @ R_reference, axis)
        return R @ rotations_about(axis, twist)
    orbit = np.stack([R @ g for g in group.elements()])
    best = np.einsum("gkij,ij->gk", orbit, R_reference).argmax(0)
    return orbit[best, np.arange(len(R))]


def _lengths(x: Array) -> Array:
    """Of vectors (..., D); `np.linalg.norm` takes its time to find out which norm is meant."""
    return np.sqrt(np.vecdot(x, x))


def _median(x: Array) -> Array:
    """Along the first axis, of a few finite numbers; `np.median` takes ten times as long to look for others."""
    ordered = np.sort(x, axis=0)
    return 0.5 * (ordered[(len(x) - 1) // 2] + ordered[len(x) // 2])


def _modes(angle: Array, distance: Array, density: Array) -> tuple[NDArray[np.intp], tuple[float, ...]]:
    """Indices of the heaviest mode's members, and the masses of all modes, heaviest first."""
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
