"""Series of lag measurements from a gentle servo to a sharp one, which ends at the first sign of vibration."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np

from toolee_robot.control import Supervisor
from toolee_robot.control.supervisor_checks import AT_REST
from toolee_robot.errors import DeviceError
from toolee_robot.hal import MotionOutcome
from toolee_robot.tasks.bring_up.caps import SlowStation
from toolee_robot.tasks.bring_up.lag_motion import LagFigures, lag_motion, measure_lag

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
                _wait_until_still(arm)
                speed = share * slow.config.arm.velocity[joint - 1]
                motion = lag_motion(arm.state().q_commanded, joint, speed, slow.config.arm)
                report = arm.execute(motion.trajectory)
                if report.outcome is not MotionOutcome.COMPLETED:
                    raise DeviceError("the arm was stopped during the measurement", code="device.stopped")
                trial = Trial(gain, lookahead, measure_lag(motion, report))
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


def _wait_until_still(arm: Supervisor) -> None:
    for _ in range(round(STILL_PATIENCE / STILL_STEP)):
        if np.max(np.abs(arm.state().joints.qd)) < AT_REST:
            return
        time.sleep(STILL_STEP)
