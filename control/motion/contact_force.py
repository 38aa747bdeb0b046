"""The force of a touch: whether it is a contact, and the height at which the face met the thing."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard
from toolee_robot.station import StrikeConfig


class ContactForce:
    """Detects a contact in the readings of one motion; a reading costs the same however long the windows are.

    Args:
        guard: What counts as a contact.
        period: Time between two readings [s].
    """

    def __init__(self, guard: ContactGuard, period: float) -> None:
        self._guard = guard
        self._window = max(round(guard.averaging_window / period), 1)
        self._baseline = max(round(guard.baseline / period), 1) if guard.baseline > 0.0 else 0
        self._readings: deque[Array] = deque()
        self._newest, self._older = np.zeros(3), np.zeros(3)  # sums over window and baseline

    def add(self, force: Array, time: float) -> bool:
        """Add a reading.

        Args:
            force: Force at the flange, (3,) [N].
            time: Time on the trajectory [s].

        Returns:
            Whether the newest readings are a contact.
        """
        readings, longest = self._readings, self._window + self._baseline
        readings.append(force)
        self._newest += force
        if len(readings) > self._window:
            self._newest -= readings[-self._window - 1]
            self._older += readings[-self._window - 1]
        if len(readings) > longest:
            self._older -= readings.popleft()
        guard = self._guard
        if len(readings) < longest or time < guard.ignore_before:
            return False
        step = self._newest / self._window
        if self._baseline:
            step -= self._older / self._baseline
        least = guard.force + (guard.sway if guard.sway_from <= time < guard.sway_until else 0.0)
        return float(step @ step) > least**2


STEP_WINDOW, STEP_BASELINE = 0.008, 0.05
"""Averaging window and baseline of a strike's contact detection [s]: one reading of a CB3 against six."""
SIGMAS = 5.5
"""Threshold of a strike's contact in standard deviations of an axis of its step: one strike in thousands ends early."""
MAX_FACTOR = 1.5
"""The noise may raise the threshold to this multiple of `strike.contact_force`; with more there are no strikes."""
ARMED_FROM = 0.5
"""Share of the time to the contact before which no force counts, because of the starting transients."""
SWAY, SWAYS = 2.0, 0.3
"""Step of the force with which a swung tool pulls at the hand, as a share of its mass times the step of its
acceleration: a mass on an undamped spring swings between none and twice. And share of the largest step from which on it
counts: before, in most of the run-up, a contact needs no more force."""
AT_NAIL = 0.8
"""Share of the distance of an early contact within which the sway no longer counts: what is felt there is the nail, and
a light hammer's contact is hardly more force than its sway."""


def _steps(values: Array, period: float) -> Array:
    """The steps that `ContactForce` forms of a strike's readings (N, 3), one every `period` [s]: (N - n, 3)."""
    window, baseline = (max(round(time / period), 1) for time in (STEP_WINDOW, STEP_BASELINE))
    rows = np.lib.stride_tricks.sliding_window_view(values, window + baseline, axis=0).swapaxes(1, 2)
    return np.asarray(rows[:, baseline:].mean(axis=1) - rows[:, :baseline].mean(axis=1))


def swing_sway(
    mass: float, times: Array, face: Array, contact_time: float, early: float, lag: float = 0.0
) -> tuple[float, float, float]:
    """Compute the step of the force with which a tool sways in the hand on its way to the nail.

    Payload compensation takes the tool for a part of the flange, and the hand yields.

    Args:
        mass: Mass of the tool [kg].
        times: Times of the swing, evenly spaced, (N,) [s].
        face: Places of the face, (N, 3) [m].
        contact_time: When the swing should meet the nail [s].
        early: How far before the nail a contact may be that counts as one with it [m].
        lag: Delay of the arm behind its command [s].

    Returns:
        The largest step before the contact, as `ContactForce` forms it [N], and from when to when it counts [s].
    """
    step = float(times[1] - times[0])
    acceleration = np.gradient(np.gradient(face, step, axis=0), step, axis=0)
    steps = np.linalg.norm(_steps(acceleration, step), axis=1)
    ends = times[-len(steps) :]
    counts = (ends >= ARMED_FROM * contact_time) & (ends <= contact_time)
    steps, ends = steps[counts], ends[counts]
    if len(steps) == 0:
        return 0.0, 0.0, 0.0
    largest = float(np.max(steps))
    away = np.linalg.norm(face - face[np.argmin(np.abs(times - contact_time))], axis=1)
    near = float(times[np.argmax(away <= AT_NAIL * early)])
    return SWAY * mass * largest, float(ends[np.argmax(steps >= SWAYS * largest)]), near + lag


def strike_guard(
    strike: StrikeConfig,
    contact_time: float,
    noise: Array | None = None,
    rate: float = 1.0,
    sway: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> ContactGuard:
    """Build the contact detection of a strike, whose threshold bears the noise of the force and the tool's sway.

    Args:
        strike: Configured force of a contact.
        contact_time: When the strike should meet the nail, on its trajectory [s].
        noise: Readings of the force at rest, one a cycle, (N, 3) [N]; None if it was not measured.
        rate: Rate of these readings [Hz].
        sway: Step of the force that the swing itself makes [N], from when and until when [s]; see `swing_sway`.

    Returns:
        The contact detection.

    Raises:
        DeviceError: The force is too noisy for the configured threshold.
    """
    needed = 0.0
    if noise is not None:
        needed = SIGMAS * float(np.sqrt(np.mean(_steps(noise, 1.0 / rate) ** 2)))
    if needed > MAX_FACTOR * strike.contact_force:
        raise DeviceError(
            f"the force at rest is so noisy that a sure contact needs a step of {needed:.0f} N, more than "
            f"strike.contact_force {strike.contact_force:g} N: no strike. Check the payload, wait until nothing "
            "swings, or raise it as far as hand and tool can bear",
            code="device.force_noise",
        )
    force = max(strike.contact_force, needed)
    return ContactGuard(force, ARMED_FROM * contact_time, STEP_WINDOW, STEP_BASELINE, *sway)


SLOPE_RANGE = 0.008
"""Height above the end of a touch over which the rise of the force is examined [m]."""
RESOLUTION = 0.1
"""Standard deviation of a reading of the force at least [N]."""
STIFFNESSES = np.geomspace(1e3, 1e5, 230)
"""Stiffnesses that are compared, 2 % from one to the next [N/m]."""
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
        deviation: Standard deviation of the height [m].
    """

    height: float
    stiffness: float
    deviation: float


@dataclass(frozen=True)
class Course:
    """Forces over the height of the face in a touch or a release.

    Attributes:
        heights: Heights, falling or rising, (N,) [m]; the lowest one is the end of a touch or the start of a release.
        forces: Upward forces, (N,) [N].
        variance: Variance of the forces, as of independent readings [N^2].
        zeros: Number of readings whose mean was made zero where nothing touched the face, and which count as well.
    """

    heights: Array
    forces: Array
    variance: float
    zeros: int = 0


@dataclass(frozen=True)
class Belief:
    """What is known of the stiffness of tool and hand beside one touch.

    Attributes:
        stiffness: The stiffness [N/m].
        deviation: Standard deviation of its logarithm.
    """

    stiffness: float
    deviation: float


UNKNOWN = Belief(8e3, 0.7)
"""Before anything was touched: a factor of two up or down is usual. Assumed; a hand in the simulation has 6.5 kN/m."""


def onset(course: Course, belief: Belief = UNKNOWN) -> Rise | None:
    """Find where a force began to rise: the mean over all lines that may be, each as likely as the forces make it.

    The offset of the force is not known. Of the line that fits best alone, a force that is noisy and short leaves
    errors of over a millimetre now and then, and does not tell which they are.

    Args:
        course: The forces.
        belief: What is known of the slope.

    Returns:
        The line; None if the force does not rise downwards.
    """
    lowest = float(np.min(course.heights))
    near = course.heights < lowest + SLOPE_RANGE
    x, f = course.heights[near], course.forces[near]
    begins = np.arange(lowest + 0.0001, lowest + 0.75 * SLOPE_RANGE, 0.00005)
    pressed = np.maximum(begins[:, None] - x, 0.0)
    n = len(x) + course.zeros
    # Covariances of depth and force about their means, which stand for the unknown offset; the zeros count as zero.
    depths = np.sum(pressed**2, axis=1) - np.sum(pressed, axis=1) ** 2 / n
    both = pressed @ f - np.sum(pressed, axis=1) * np.sum(f) / n
    if not np.any(both > 0.0):
        return None
    gain = 2.0 * np.outer(both, STIFFNESSES) - np.outer(depths, STIFFNESSES**2)  # squares that the line explains [N^2]
    doubt = (np.log(STIFFNESSES / belief.stiffness) / belief.deviation) ** 2
    likelihood = 0.5 * (gain / max(course.variance, RESOLUTION**2) - doubt)
    weights = np.exp(likelihood - np.max(likelihood))
    weights /= np.sum(weights)
    of_height = np.sum(weights, axis=1)
    height = float(of_height @ begins)
    stiffness = float(np.exp(np.sum(weights, axis=0) @ np.log(STIFFNESSES)))
    return Rise(height, stiffness, float(np.sqrt(of_height @ (begins - height) ** 2)))


class Releases:
    """The releases at one nail, each of which tells the others how stiff tool and hand are.

    How stiff they are is what the noise of the force hides most: a line that is fitted too steep begins too low.
    """

    def __init__(self) -> None:
        self._known: dict[int, tuple[Course, float]] = {}  # forces, and the stiffness of each by itself [N/m]
        self._last = 0

    def add(self, course: Course, stiffness: float) -> int:
        """Add a release.

        Args:
            course: Its forces.
            stiffness: What it tells by itself [N/m].

        Returns:
            Its number.
        """
        self._last += 1
        self._known[self._last] = course, stiffness
        return self._last

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
        rise = onset(self._known[number][0], self.belief(number))
        assert rise is not None, "it rose when it was added"
        return rise.height

    def belief(self, but: int = 0) -> Belief:
        """What the releases say about the stiffness.

        Args:
            but: Number of a release that does not count; 0 for none.

        Returns:
            The stiffness; `UNKNOWN` without any release.
        """
        told = [stiffness for number, (_, stiffness) in self._known.items() if number != but]
        if not told:
            return UNKNOWN
        return Belief(float(np.median(told)), float(np.hypot(SPREAD, ALONE / np.sqrt(len(told)))))
