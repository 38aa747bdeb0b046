"""Where the force of a touch begins: the height at which the face met the thing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array

SLOPE_RANGE = 0.008
"""Height above the end of a touch over which the rise of the force is examined [m]."""
SPREAD = 0.05
"""Standard deviation of the stiffness among the touches of one nail, as a share of it. The hand yields, whatever the
face presses on: of 60 simulated releases in eight jobs the true ones deviate by 4 % from their job's median."""
ALONE = 0.15
"""Standard deviation of the stiffness that one release with a CB3's noise tells by itself, as a share of it, of the
same releases."""


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


@dataclass(frozen=True)
class Belief:
    """What is known of the stiffness of tool and hand beside one touch.

    Attributes:
        stiffness: The stiffness [N/m].
        deviation: Its standard deviation [N/m].
    """

    stiffness: float
    deviation: float


def onset(course: Course, belief: Belief | None = None, variance: float = 0.0) -> Rise | None:
    """Find where a force began to rise, by the least squares of a force that is constant above and linear below.

    Args:
        course: The forces.
        belief: What is known of the slope; None for nothing.
        variance: Variance of the forces, as of independent readings [N^2]; of use with a belief.

    Returns:
        The line; None if the force does not rise downwards.
    """
    lowest = float(np.min(course.heights))
    near = course.heights < lowest + SLOPE_RANGE
    x = np.concatenate([course.heights[near], np.full(course.zeros, np.inf)])
    f = np.concatenate([course.forces[near], np.zeros(course.zeros)])
    weight = 0.0 if belief is None else float(np.sqrt(variance)) / belief.deviation
    f = np.append(f, 0.0 if belief is None else weight * belief.stiffness)
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
    """The releases at one nail, each of which tells the others how stiff tool and hand are.

    How stiff they are is what the noise of the force hides most: a line that is fitted too steep begins too low.

    Attributes:
        variance: Variance of the forces, as of independent readings [N^2].
    """

    def __init__(self) -> None:
        self.variance = 0.0
        self._known: dict[int, tuple[Course, float]] = {}  # forces, and the stiffness of each by itself [N/m]
        self._count = 0

    @property
    def stiffness(self) -> float | None:
        """Stiffness that the releases have told [N/m]; None without any."""
        return float(np.median([stiffness for _, stiffness in self._known.values()])) if self._known else None

    def add(self, course: Course, stiffness: float) -> int:
        """Add a release.

        Args:
            course: Its forces.
            stiffness: What it tells by itself [N/m].

        Returns:
            Its number.
        """
        self._count += 1
        self._known[self._count] = course, stiffness
        return self._count

    def drop(self, number: int) -> None:
        """Forget a release that was none.

        Args:
            number: Which release.
        """
        self._known.pop(number, None)

    def height(self, number: int) -> float:
        """Height at which the face met the thing, by what all releases have told so far.

        Args:
            number: Which release; one that was not dropped.

        Returns:
            The height [m].
        """
        others = [stiffness for other, (_, stiffness) in self._known.items() if other != number]
        belief = None
        if others:
            stiffness = float(np.median(others))
            belief = Belief(stiffness, stiffness * float(np.hypot(SPREAD, ALONE / np.sqrt(len(others)))))
        rise = onset(self._known[number][0], belief, self.variance)
        assert rise is not None, "it rose when it was added"
        return rise.height
