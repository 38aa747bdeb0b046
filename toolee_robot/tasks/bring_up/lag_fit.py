"""What a `LagMotion` shows of the servo: its delay, its gain, its overshoot, and vibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.tasks.bring_up.lag_motion import REST, LagMotion

LONGEST_LAG = 0.4
"""Largest delay that is looked for [s]."""
FAST = 0.08
"""Window of the moving average whose difference from the joint counts as vibration [s]: all of it above some 10 Hz."""
VIBRATION, NOISES = 2e-4, 2.5
"""Vibration begins where the fast part of the joint's deviation exceeds this [rad], and so many times the same at rest
(assumed; no robot was measured)."""


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
    fast = _fast_part(t, measured - np.interp(t - lag, t, command))
    still, moving = _rms(fast[rest]), _rms(fast[~rest])
    noise = float(np.std(measured[rest]))
    overshoot = max(beyond - 3 * noise, 0.0) / abs(motion.size)
    vibrates = moving > max(VIBRATION, NOISES * still)
    return LagFigures(motion.speed, lag, fit(lag)[0], overshoot, noise, moving, vibrates, _ratio(report))


def _ratio(report: MotionReport) -> float | None:
    columns = (report.position_deviation_ratios, report.collision_ratios)
    known = [float(np.nanmax(column)) for column in columns if column is not None and np.any(np.isfinite(column))]
    return max(known, default=None)


def _fast_part(t: Array, x: Array) -> Array:
    """What of x is faster than a moving average over FAST, which is cut at both ends."""
    width = max(3, round(FAST / float(np.median(np.diff(t)))) | 1)
    slow = np.convolve(x, np.full(width, 1.0 / width), mode="same")
    inner = np.zeros(len(x))
    inner[width:-width] = (x - slow)[width:-width]
    return inner


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
