"""Where the force of a touch begins: the height at which the face met the thing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array

SLOPE_RANGE = 0.008
"""Height above the end of a touch over which the rise of the force is examined [m]."""
SPREAD = 0.1
"""Standard deviation of the stiffness among the touches of one job, as a share of it. The hand yields, whatever the
face presses on: of 60 simulated releases in eight jobs the true ones deviate by 8 % from their job's median."""


@dataclass(frozen=True)
class Rise:
    """Course of a force that is constant above a height and linear below it.

    Attributes:
        height: Height at which the line begins [m].
        stiffness: Slope of the line [N/m].
    """

    height: float
    stiffness: float


@dataclass(frozen=True)
class Course:
    """Forces over the height of the face in a touch or a release.

    Attributes:
        heights: Heights, falling or rising, (N,) [m]; the lowest one is the end of a touch or the start of a release.
        forces: Upward forces, (N,) [N].
        zeros: Number of readings whose mean was made zero where nothing touched the face, and which count as well.
    """

    heights: Array
    forces: Array
    zeros: int = 0


def onset(course: Course, stiffness: float | None = None, variance: float = 0.0) -> Rise | None:
    """Find where a force began to rise, by the least squares of a force that is constant above and linear below.

    Args:
        course: The forces.
        stiffness: What other touches of the job have told of the slope [N/m], `SPREAD` being their spread; None for
            nothing.
        variance: Variance of the forces, as of independent readings [N^2]; of use with `stiffness`.

    Returns:
        The line; None if the force does not rise downwards.
    """
    lowest = float(np.min(course.heights))
    near = course.heights < lowest + SLOPE_RANGE
    x = np.concatenate([course.heights[near], np.full(course.zeros, np.inf)])
    f = np.concatenate([course.forces[near], np.zeros(course.zeros)])
    weight = 0.0 if stiffness is None else float(np.sqrt(variance)) / (SPREAD * stiffness)
    f = np.append(f, weight * (stiffness or 0.0))
    best, rise = np.inf, None
    for begin in np.arange(lowest + 0.0001, lowest + 0.75 * SLOPE_RANGE, 0.0001):
        A = np.zeros((len(f), 2))
        A[:-1, 0], A[:-1, 1], A[-1, 1] = 1.0, np.maximum(begin - x, 0.0), weight
        solution, *_ = np.linalg.lstsq(A, f, rcond=None)
        rest = float(np.sum((A @ solution - f) ** 2))
        if solution[1] > 0.0 and rest < best:
            best, rise = rest, Rise(float(begin), float(solution[1]))
    return rise


class Releases:
    """The releases of one job, each of which tells the others how stiff tool and hand are.

    How stiff they are is what the noise of the force hides most: a line that is fitted too steep begins too low.
    """

    def __init__(self) -> None:
        self._courses: list[Course] = []
        self._stiffnesses: list[float] = []  # of each by itself [N/m]

    @property
    def stiffness(self) -> float | None:
        """Stiffness that the releases have told [N/m]; None without any."""
        return float(np.median(self._stiffnesses)) if self._stiffnesses else None

    def add(self, course: Course, stiffness: float) -> int:
        """Add a release.

        Args:
            course: Its forces.
            stiffness: What it tells by itself [N/m].

        Returns:
            Its index.
        """
        self._courses.append(course)
        self._stiffnesses.append(stiffness)
        return len(self._courses) - 1

    def height(self, index: int, variance: float) -> float:
        """Height at which the face met the thing, by what all releases have told so far.

        Args:
            index: Which release.
            variance: Variance of the forces, as of independent readings [N^2].

        Returns:
            The height [m].
        """
        others = self._stiffnesses[:index] + self._stiffnesses[index + 1 :]
        rise = onset(self._courses[index], float(np.median(others)) if others else None, variance)
        assert rise is not None, "it rose when it was added"
        return rise.height
