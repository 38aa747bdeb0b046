"""Mass and centre of mass of a held tool, from the wrench that the arm feels at rest in several orientations.

The wrench has an offset that turns with the flange and changes a little from posture to posture, and the arm
compensates a payload of the hand that may be wrong. Readings with the empty hand are taken in the first of the postures
with the tool, where the difference is the tool alone, and where the wrist is turned, which tells how wrong the hand's
payload is. The others turn the tool's weight in the flange, while the offset stays. All of it is one linear
least-squares problem with Gaussian priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolee_robot.errors import WeighingError
from toolee_robot.frames import Array

LEAST_TURN = np.deg2rad(45.0)
"""Least angle between the directions of gravity in the flange of two of the readings [rad]."""
LEAST_READINGS = 3
"""Least number of readings with the tool."""
BATCHES = 8
"""Number of parts of a reading whose means tell its noise: longer than the noise's correlation."""
LEAST_NOISE = 0.01, 0.001
"""Least standard deviation of a mean: force [N] and torque [Nm]; a simulated arm may have none."""
USUAL_CONTRADICTION, LARGEST_CONTRADICTION = 1.2, 3.0
"""Difference of the mass with and without the readings of the empty hand, in its standard deviations: from the first on
the result is less certain, over the second there is none."""
_WIDE = np.array([20.0, 6.0, 6.0, 6.0, *(200.0,) * 3, *(100.0,) * 3])
"""Standard deviations of the priors that say nothing: mass [kg] and moments [kg m] of the tool, offset [N, Nm]."""


@dataclass(frozen=True, eq=False)
class RestReading:
    """What the arm feels at rest in one posture.

    Attributes:
        R_base_flange: Orientation of the flange, (3, 3).
        wrench: Mean force [N] and torque [Nm] about the flange's origin, (6,), axes of `base`; the payload of the hand
            alone is compensated.
        noise: Standard deviation of that mean per axis, as its parts tell: of the force [N] and of the torque [Nm].
        count: Number of readings of which it is the mean.
    """

    R_base_flange: Array
    wrench: Array
    noise: tuple[float, float]
    count: int


@dataclass(frozen=True, eq=False)
class WeighingPrior:
    """What is known before a tool is weighed: standard deviations, and where the hand holds its handle.

    Attributes:
        posture: Change of the wrench's error from posture to posture, per axis: force [N] and torque [Nm].
        hand_mass: Error of the hand's mass that the arm compensates [kg].
        hand_moment: Error of its mass times its centre of mass, axes of the flange, (3,) [kg m].
        time: What presses on the arm since the empty hand was felt, the same in all postures, per axis of `base`:
            force [N] and torque [Nm].
        aged: Change of the wrench's own error since then, the same in all postures, per axis of the flange: force [N]
            and torque [Nm].
        pressed: What touches the arm in one of the readings of a pair, with and without the tool, per axis: force [N]
            and torque [Nm].
        grip: A point of the handle's axis, flange frame, (3,) [m].
        handle: Direction of that axis, flange frame, (3,), of length 1.
        handle_moment: Mass times distance of the centre of mass from it [kg m].
    """

    posture: tuple[float, float]
    hand_mass: float
    hand_moment: Array
    time: tuple[float, float]
    aged: tuple[float, float]
    pressed: tuple[float, float]
    grip: Array
    handle: Array
    handle_moment: float


@dataclass(frozen=True, eq=False)
class ToolWeight:
    """Weight of a tool.

    Attributes:
        mass: Mass [kg].
        mass_sigma: Its standard deviation [kg].
        center_of_mass: Centre of mass, flange frame, (3,) [m].
        center_covariance: Its covariance, (3, 3) [m^2].
    """

    mass: float
    mass_sigma: float
    center_of_mass: Array
    center_covariance: Array

    @property
    def center_sigma(self) -> float:
        """Standard deviation of the centre of mass in the direction in which it is known least [m]."""
        return float(np.sqrt(np.linalg.eigvalsh(self.center_covariance)[-1]))


def rest_reading(R_base_flange: Array, wrenches: Array) -> RestReading:
    """Average what an arm feels at rest.

    Args:
        R_base_flange: Orientation of the flange, (3, 3).
        wrenches: Readings of the wrench, (N, 6) [N, Nm], axes of `base`; the longer, the better is their noise known.

    Returns:
        Their mean, and its standard deviation by the means of `BATCHES` parts, whatever the noise's correlation within
        one.
    """
    parts = np.array([part.mean(axis=0) for part in np.array_split(wrenches, min(BATCHES, len(wrenches)))])
    variance = np.var(parts, axis=0, ddof=1) / len(parts) if len(parts) > 1 else np.full(6, np.inf)
    return RestReading(R_base_flange, wrenches.mean(axis=0), _pair(variance), len(wrenches))


def weigh(
    held: Sequence[RestReading], empty: Sequence[RestReading], gravity: Array, prior: WeighingPrior
) -> ToolWeight:
    """Compute mass and centre of mass of a tool.

    Args:
        held: Readings with the tool, the first of them in the postures of `empty`.
        empty: Readings with the empty hand, one or more.
        gravity: Acceleration of free fall in `base`, (3,) [m/s^2].
        prior: What is known before.

    Returns:
        The weight. Where the readings contradict each other by more than they should, or those with the tool those
        without it, its standard deviations are as much larger.

    Raises:
        WeighingError: There are too few readings, or gravity has nearly the same direction in the flange in all of
            them (`weighing.orientations`); the mass against the empty hand is not that by turning the tool
            (`weighing.uncertain`); or the mass is no mass (`weighing.not_held`).
    """
    directions = np.array([reading.R_base_flange.T @ gravity for reading in held]) / np.linalg.norm(gravity)
    turn = float(np.arccos(np.clip((directions @ directions.T).min(), -1.0, 1.0))) if len(held) else 0.0
    if len(held) < LEAST_READINGS or turn < LEAST_TURN:
        raise WeighingError(
            f"the arm has weighed the tool in {len(held)} orientations within {np.rad2deg(turn):.0f}°, and needs "
            f"{LEAST_READINGS} over {np.rad2deg(LEAST_TURN):.0f}° or more. Clear the space around the handover, or "
            "weigh the tool on scales and write tool.mass and tool.center_of_mass",
            code="weighing.orientations",
        )
    mean, covariance, misfit = _solved(held, empty, gravity, prior)
    # The mass comes mostly from the pairs of readings in one posture; turning the tool tells it less well.
    mean_of_held, covariance_of_held, misfit_of_held = _solved(held, (), gravity, prior)
    apart = mean[0] - mean_of_held[0]
    expected = misfit_of_held * (covariance_of_held[0, 0] - covariance[0, 0])
    contradiction = float(apart / np.sqrt(max(expected, 1e-12)))
    covariance = covariance * misfit * max(1.0, (contradiction / USUAL_CONTRADICTION) ** 2)
    mass, moment = float(mean[0]), mean[1:4]
    mass_sigma = float(np.sqrt(covariance[0, 0]))
    if abs(contradiction) > LARGEST_CONTRADICTION:
        raise WeighingError(
            f"two weighings disagree: {mass:.2f} kg against the empty hand, and {mean_of_held[0]:.2f} kg by turning "
            "the tool. Keep arm and hand free of contact, and check hand.weighed. Or weigh the tool on scales and "
            "write tool.mass and tool.center_of_mass",
            code="weighing.uncertain",
        )
    if not mass > 2.0 * mass_sigma:
        raise WeighingError(
            f"the arm feels a tool of {mass:.2f} ± {mass_sigma:.2f} kg, which may be no tool. Check whether the "
            "hand holds it, or weigh it on scales and write tool.mass and tool.center_of_mass",
            code="weighing.not_held",
        )
    J = np.column_stack([-moment / mass**2, np.eye(3) / mass])
    return ToolWeight(mass, mass_sigma, np.asarray(moment / mass, dtype=np.float64), J @ covariance @ J.T)


def expected_covariance(
    Rs_base_flange: Sequence[Array], empty: int, gravity: Array, noise: tuple[float, float], prior: WeighingPrior
) -> Array:
    """Predict how well orientations would tell a tool's weight.

    Args:
        Rs_base_flange: Orientations of the flange, (3, 3) each.
        empty: In how many of the first of them there is a reading without the tool, too.
        gravity: Acceleration of free fall in `base`, (3,) [m/s^2].
        noise: Standard deviation of a reading's mean, per axis: force [N] and torque [Nm].
        prior: What is known before.

    Returns:
        Covariance of mass [kg] and moments [kg m] of the tool, (4, 4).
    """
    noises = np.tile(noise, (len(Rs_base_flange) + empty, 1))
    rows, sigma = _equations(Rs_base_flange, empty, gravity, noises, prior)
    return _covariance(rows, sigma, _known(prior, empty))[:4, :4]


def _solved(
    held: Sequence[RestReading], empty: Sequence[RestReading], gravity: Array, prior: WeighingPrior
) -> tuple[Array, Array, float]:
    """Mass and moments of the tool, (4,), their covariance, (4, 4), and the misfit's share of variance, at least 1."""
    readings = [*held, *empty]
    # The noise is the same in all: what the parts of each tell of it is pooled.
    density = np.mean([np.square(reading.noise) * reading.count for reading in readings], axis=0)
    noises = np.sqrt([density / reading.count for reading in readings])
    wrenches = np.concatenate([_in_flange(reading) for reading in readings])
    rows, sigma = _equations([reading.R_base_flange for reading in held], len(empty), gravity, noises, prior)
    known = _known(prior, len(empty))
    covariance = _covariance(rows, sigma, known)
    solution = covariance @ rows.T @ (wrenches / sigma**2)
    misfit = np.sum(((wrenches - rows @ solution) / sigma) ** 2) + np.sum((known @ solution) ** 2)
    freedom = len(wrenches) - _FREE
    return np.asarray(solution[:4], dtype=np.float64), covariance[:4, :4], max(1.0, float(misfit) / freedom)


def _covariance(rows: Array, sigma: Array, known: Array) -> Array:
    """Covariance of the unknowns, (U, U), by the readings' equations and what is known."""
    return np.asarray(np.linalg.inv(rows.T @ (rows / sigma[:, None] ** 2) + known.T @ known), dtype=np.float64)


# The unknowns: mass and moments of the tool (4), the offset (6), and, with priors of their own, the error of the hand's
# mass and moments (4), what presses since the empty hand (6), how the wrench has aged since (6), and the change of the
# offset in each posture of a pair (6). The first ten are free, but for the two that the handle's axis tells.
_FREE, _SHARED = 8, 26


def _equations(
    Rs_base_flange: Sequence[Array], empty: int, gravity: Array, noises: Array, prior: WeighingPrior
) -> tuple[Array, Array]:
    """Rows of the readings with the tool, then of those without, in the flange, and their standard deviations."""
    count = len(Rs_base_flange)
    rows = np.zeros((6 * (count + empty), _SHARED + 6 * empty))
    sigma = np.repeat(np.maximum(noises, LEAST_NOISE), 3, axis=1)
    sigma[empty:count] = np.hypot(sigma[empty:count], np.repeat(prior.posture, 3))
    for pair in (slice(empty), slice(count, None)):
        sigma[pair] = np.hypot(sigma[pair], np.repeat(prior.pressed, 3))
    for k in range(count + empty):
        held, posture = k < count, k if k < count else k - count
        block = rows[6 * k : 6 * k + 6]
        weight = _weight_rows(Rs_base_flange[posture].T @ gravity)
        block[:, 4:10] = np.eye(6)
        block[:, 10:14] = weight
        if held:
            block[:, 0:4] = weight
            block[:3, 14:17] = block[3:, 17:20] = Rs_base_flange[posture].T
            block[:, 20:26] = np.eye(6)
        if posture < empty:
            block[:, _SHARED + 6 * posture :][:, :6] = np.eye(6)
    return rows, sigma.ravel()


def _weight_rows(g: Array) -> Array:
    """Wrench of a weight by its mass and moments, (6, 4), for gravity (3,) in the flange's axes."""
    x, y, z = g
    rows = np.zeros((6, 4))
    rows[:3, 0] = g
    rows[3:, 1:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return rows


def _known(prior: WeighingPrior, empty: int) -> Array:
    """What is known of the unknowns, as rows that are 0 with a standard deviation of 1, (U + 3, U)."""
    hand, since = (
        [prior.hand_mass, *prior.hand_moment],
        np.repeat([*prior.time, *np.maximum(prior.aged, LEAST_NOISE)], 3),
    )
    sigma = np.concatenate([_WIDE, hand, since, np.tile(np.repeat(prior.posture, 3), empty)])
    beside = (np.eye(3) - np.outer(prior.handle, prior.handle)) / prior.handle_moment
    rows = np.vstack([np.diag(1.0 / sigma), np.zeros((3, len(sigma)))])
    rows[-3:, 0], rows[-3:, 1:4] = -beside @ prior.grip, beside
    return rows


def _in_flange(reading: RestReading) -> Array:
    return np.asarray((reading.wrench.reshape(2, 3) @ reading.R_base_flange).ravel())


def _pair(variances: Array) -> tuple[float, float]:
    """Standard deviations of force and torque, from variances along the axes, (6,)."""
    return float(np.sqrt(variances[:3].mean())), float(np.sqrt(variances[3:].mean()))
