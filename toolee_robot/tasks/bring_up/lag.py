"""Measurement of a servo's lag by motions of one joint, and series from gentle settings to sharp ones.

A motion is rest, sine, smooth step, rest, and the step back. A series ends at the first sign of vibration.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from toolee_robot.control import Supervisor
from toolee_robot.control.planning.timing import SAMPLE_PERIOD
from toolee_robot.control.supervisor_checks import AT_REST
from toolee_robot.errors import DeviceError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, MotionReport
from toolee_robot.station import ArmLimits
from toolee_robot.tasks.bring_up.slow_motions import SlowStation
from toolee_robot.types import Trajectory

REST = 0.6
"""Duration of every rest [s]."""
PERIODS = 3
"""Whole periods of the sine at its full amplitude; one before and one after grow and fade."""
MARGIN = 0.98
"""Share of the limits that the motion uses."""
LONGEST_LAG = 0.4
"""Largest delay that is looked for [s]."""
FAST = 0.08
"""Window of the moving average whose difference from the joint counts as vibration [s]: all of it above some 10 Hz."""
VIBRATION, NOISES = 2e-4, 2.5
"""Vibration begins where the fast part of the joint's deviation exceeds this [rad], and so many times the same at rest
(assumed; no robot was measured)."""


@dataclass(frozen=True)
class LagMotion:
    """A motion of one joint that ends where it began.

    Attributes:
        trajectory: The motion of the six joints.
        joint: Index of the joint, 0 to 5.
        speed: Largest speed of the joint [rad/s].
        sine: Times at which the sine begins and ends on the trajectory [s].
        step: Times at which the step begins and ends [s].
        size: Size of the step [rad].
    """

    trajectory: Trajectory
    joint: int
    speed: float
    sine: tuple[float, float]
    step: tuple[float, float]
    size: float

    @property
    def reach(self) -> float:
        """Largest distance of the joint from its start [rad]."""
        q = self.trajectory.q[:, self.joint]
        return float(np.max(np.abs(q - q[0])))


def lag_motion(q: Array, joint: int, speed: float, limits: ArmLimits) -> LagMotion:
    """Build the motion.

    Args:
        q: Present joint positions, (6,) [rad].
        joint: Number of the joint, 1 (base) to 6 (wrist 3).
        speed: Largest speed of the joint [rad/s]; its limit holds where that is lower.
        limits: Limits of velocity, acceleration and jerk.

    Returns:
        The motion, from rest to rest.

    Raises:
        UserError: There is no such joint, or the speed is not positive.
    """
    if not 1 <= joint <= 6:
        raise UserError(f"joint {joint}: give 1 (base) to 6 (wrist 3)")
    if not speed > 0:
        raise UserError(f"a speed of {speed} rad/s: give a positive number")
    top = MARGIN * min(speed, limits.velocity[joint - 1])
    acceleration, jerk = MARGIN * limits.transfer_acceleration, MARGIN * limits.jerk
    rest = np.zeros((3, round(REST / SAMPLE_PERIOD)))
    wave, step, size = _sine(top, acceleration, jerk), *_step(top, acceleration, jerk)
    x = np.hstack([rest, wave, rest, step, _held(rest, size), _back(step, size), rest])
    times = SAMPLE_PERIOD * np.arange(x.shape[1])
    full = np.zeros((3, x.shape[1], 6))
    full[:, :, joint - 1] = x
    full[0] += q
    begin, long = rest.shape[1], wave.shape[1]
    first = begin + long + rest.shape[1]
    edges = SAMPLE_PERIOD * np.array([begin, begin + long, first, first + step.shape[1]])
    a, b, c, d = edges.tolist()
    return LagMotion(Trajectory(times, *full), joint - 1, float(np.max(np.abs(x[1]))), (a, b), (c, d), size)


def _sine(speed: float, acceleration: float, jerk: float) -> Array:
    """Position, velocity, acceleration of a sine that grows and fades, (3, N); all zero at both ends."""
    # At this frequency a sine of that speed has that acceleration, or that jerk where it is the lower one.
    omega = 0.8 * min(acceleration / speed, np.sqrt(jerk / speed))
    period = 2 * np.pi / omega
    t = np.arange(0.0, (PERIODS + 2) * period, SAMPLE_PERIOD)
    up, down = _smooth(t / period, period), _smooth((PERIODS + 2) - t / period, -period)
    grows = t < (0.5 * PERIODS + 1) * period
    w, dw, ddw = (np.where(grows, a, b) for a, b in zip(up, down, strict=True))
    s, c = np.sin(omega * t), omega * np.cos(omega * t)
    x = np.stack([w * s, dw * s + w * c, ddw * s + 2 * dw * c - w * omega**2 * s])
    jerks = np.abs(np.diff(x[2], append=0.0)) / SAMPLE_PERIOD
    scale = min(speed / np.max(np.abs(x[1])), acceleration / np.max(np.abs(x[2])), jerk / np.max(jerks))
    return np.asarray(scale * x)


def _smooth(u: Array, period: float) -> tuple[Array, Array, Array]:
    """A smooth step in u from 0 to 1, and its first two derivatives by time, where du/dt is 1/period."""
    v = np.clip(u, 0.0, 1.0)
    return (
        v**3 * (10 - 15 * v + 6 * v**2),
        30 * v**2 * (1 - v) ** 2 / period,
        60 * v * (1 - v) * (1 - 2 * v) / period**2,
    )


def _step(speed: float, acceleration: float, jerk: float) -> tuple[Array, float]:
    """Position, velocity, acceleration of a smooth step, (3, N), and its size [rad]."""
    # Of the polynomial of degree 5: largest velocity 15/8, acceleration 5.78, jerk 60, for a size and a duration of 1.
    duration = max(5.78 / 1.875 * speed / acceleration, float(np.sqrt(60 / 1.875 * speed / jerk)))
    size = speed * duration / 1.875
    t = np.arange(0.0, duration, SAMPLE_PERIOD)
    return size * np.stack(_smooth(t / duration, duration)), size


def _held(rest: Array, size: float) -> Array:
    held = rest.copy()
    held[0] = size
    return held


def _back(step: Array, size: float) -> Array:
    back = -step
    back[0] += size
    return np.asarray(back)


@dataclass(frozen=True)
class LagFigures:
    """What one motion has shown.

    Attributes:
        speed: Largest commanded speed of the joint [rad/s].
        lag: Delay of the measured joint behind the command, by least squares over the sine [s]; it includes the network
            and up to one cycle until a reading is used.
        gain: Amplitude of the measured sine over the commanded one.
        overshoot: Largest way beyond the step's end, over the step's size.
        noise: Standard deviation of the joint's encoder at rest [rad].
        vibration: Root mean square of the joint's fast deviation from the delayed command in motion [rad].
        vibrates: Whether that is more than noise.
        ratio: How near the motion came to a protective stop, which comes at 1: the larger one of the controller's
            ratios of position deviation and collision detection; None where it has neither.
    """

    speed: float
    lag: float
    gain: float
    overshoot: float
    noise: float
    vibration: float
    vibrates: bool
    ratio: float | None


def measure_lag(motion: LagMotion, report: MotionReport) -> LagFigures:
    """Evaluate a motion that was executed whole.

    Args:
        motion: What was commanded.
        report: What was sent and measured.

    Returns:
        The figures.
    """
    t = report.stamps - report.stamps[0]
    command, measured = report.q_commanded[:, motion.joint], report.q_measured[:, motion.joint]
    sine = (t >= motion.sine[0]) & (t <= motion.sine[1])

    def fit(lag: float) -> tuple[float, float, float]:
        """Gain, offset and residual for a delay."""
        x = np.interp(t[sine] - lag, t, command)
        A = np.column_stack([x - x.mean(), np.ones(len(x))])
        (gain, offset), *_ = np.linalg.lstsq(A, measured[sine], rcond=None)
        return float(gain), float(offset), float(np.sum((A @ [gain, offset] - measured[sine]) ** 2))

    grid = np.linspace(0.0, LONGEST_LAG, 81)
    coarse = float(grid[np.argmin([fit(lag)[2] for lag in grid])])
    step = grid[1]
    bounds = (max(coarse - step, 0.0), coarse + step)
    lag = float(minimize_scalar(lambda x: fit(x)[2], bounds=bounds, method="bounded", options={"xatol": 1e-5}).x)
    end = np.interp(motion.step[1] + 0.5 * REST, t, command)
    after = (t > motion.step[0]) & (t < motion.step[1] + REST)
    beyond = float(np.max(np.sign(motion.size) * (measured[after] - end)))
    rest = t < 0.9 * REST
    fast = fast_part(t, measured - np.interp(t - lag, t, command))
    still, moving = rms(fast[rest]), rms(fast[~rest])
    noise = float(np.std(measured[rest]))
    overshoot = max(beyond - 3 * noise, 0.0) / abs(motion.size)
    vibrates = moving > max(VIBRATION, NOISES * still)
    return LagFigures(motion.speed, lag, fit(lag)[0], overshoot, noise, moving, vibrates, stop_ratio(report))


def stop_ratio(report: MotionReport) -> float | None:
    """How near a motion came to a protective stop; see `LagFigures.ratio`."""
    columns = (report.position_deviation_ratios, report.collision_ratios)
    known = [float(np.nanmax(column)) for column in columns if column is not None and np.any(np.isfinite(column))]
    return max(known, default=None)


def fast_part(t: Array, x: Array) -> Array:
    """What of x is faster than a moving average over FAST, which is cut at both ends."""
    width = max(3, round(FAST / float(np.median(np.diff(t)))) | 1)
    slow = np.convolve(x, np.full(width, 1.0 / width), mode="same")
    inner = np.zeros(len(x))
    inner[width:-width] = (x - slow)[width:-width]
    return inner


def rms(x: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))


PAIRS = ((200.0, 0.2), (300.0, 0.1), (500.0, 0.08), (800.0, 0.06), (1200.0, 0.04), (2000.0, 0.03))
"""Gain and lookahead [s], gentle to sharp. 300 and 0.1 are URScript's defaults, 2000 and 0.03 the end of its range."""
SHARES = (0.25, 0.5, 1.0)
"""Rising speeds, as shares of the cap."""
OVERSHOOT = 0.05
"""Overshoot above which a pair is as bad as one that vibrates, as a share of the step."""
RATIO = 0.5
"""Ratio to a protective stop above which a pair is bad, too."""
ENOUGH = 1.15
"""A gentler servo is good enough whose lag is at most so many times the shortest."""
STILL_PATIENCE, STILL_STEP = 1.0, 0.02  # [s]


@dataclass(frozen=True)
class Trial:
    """One motion with one pair.

    Attributes:
        gain: Gain of servoj.
        lookahead: Lookahead time of servoj [s].
        figures: What the motion has shown.
    """

    gain: float
    lookahead: float
    figures: LagFigures

    @property
    def bad(self) -> bool:
        """Whether the arm vibrated, overshot, or came near a protective stop."""
        f = self.figures
        return f.vibrates or f.overshoot > OVERSHOOT or (f.ratio is not None and f.ratio > RATIO)


@dataclass(frozen=True)
class Recommendation:
    """Servo settings for the station file.

    Attributes:
        gain: Gain of servoj.
        lookahead: Lookahead time of servoj [s].
        lag: Largest lag that was measured with them, rounded up to a millisecond [s].
    """

    gain: float
    lookahead: float
    lag: float


def tune(
    open_with: Callable[[float, float], AbstractContextManager[Supervisor]],
    slow: SlowStation,
    joint: int,
    pairs: Sequence[tuple[float, float]] = PAIRS,
) -> Iterator[Trial]:
    """Try pairs of gain and lookahead, each with rising speeds, until one is bad.

    Args:
        open_with: Opens the arm with a gain and a lookahead [s].
        slow: The station under its caps.
        joint: Number of the joint that moves, 1 to 6.
        pairs: The pairs, gentle to sharp.

    Yields:
        The trials, one motion each; the last one may be bad.

    Raises:
        DeviceError: A motion was stopped.
        TooleeError: What `Supervisor.execute` raises.
    """
    for gain, lookahead in pairs:
        with open_with(gain, lookahead) as arm:
            for share in SHARES:
                speed = share * slow.config.arm.velocity[joint - 1]
                motion = lag_motion(arm.state().q_commanded, joint, speed, slow.config.arm)
                trial = Trial(gain, lookahead, measure_lag(motion, execute_whole(arm, motion.trajectory)))
                yield trial
                if trial.bad:
                    return


def recommend(trials: Sequence[Trial]) -> Recommendation | None:
    """Choose a pair from a series.

    Args:
        trials: The trials in their order.

    Returns:
        The gentlest of the clean pairs whose lag is near the shortest; where the series ended at a bad pair, one step
        away from it at least. None if no pair is left.
    """
    bad = [i for i, trial in enumerate(trials) if trial.bad]
    pairs = list(dict.fromkeys((trial.gain, trial.lookahead) for trial in trials))
    if bad:
        pairs = pairs[: max(pairs.index((trials[bad[0]].gain, trials[bad[0]].lookahead)) - 1, 0)]
    lags = {pair: max(trial.figures.lag for trial in trials if (trial.gain, trial.lookahead) == pair) for pair in pairs}
    if not lags:
        return None
    shortest = min(lags.values())
    gain, lookahead = next(pair for pair in pairs if lags[pair] <= ENOUGH * shortest)
    return Recommendation(gain, lookahead, float(np.ceil(1e3 * lags[gain, lookahead]) / 1e3))


def execute_whole(arm: Supervisor, trajectory: Trajectory) -> MotionReport:
    """Execute a motion once the arm stands.

    Args:
        arm: The arm.
        trajectory: The motion, from rest to rest.

    Returns:
        What was sent and measured.

    Raises:
        DeviceError: The motion was stopped.
        TooleeError: What `Supervisor.execute` raises.
    """
    for _ in range(round(STILL_PATIENCE / STILL_STEP)):
        if np.max(np.abs(arm.state().joints.qd)) < AT_REST:
            break
        time.sleep(STILL_STEP)
    report = arm.execute(trajectory)
    if report.outcome is not MotionOutcome.COMPLETED:
        raise DeviceError("the arm was stopped during the measurement")
    return report
