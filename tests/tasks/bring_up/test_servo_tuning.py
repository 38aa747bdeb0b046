"""The lag that is measured is the lag that there is, vibration ends a series, and gentle settings are preferred."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.control.paper_arm import Bystander, PaperArm
from toolee_robot.control import Supervisor
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionOutcome, MotionReport, MotionWatch
from toolee_robot.station import sim_station
from toolee_robot.tasks.bring_up.lag import PAIRS, SHARES, Trial, recommend, tune
from toolee_robot.tasks.bring_up.slow_motions import Caps, SlowStation
from toolee_robot.types import Trajectory

SLOW = SlowStation.of(sim_station(), Caps())
HOME = np.array(SLOW.config.scene.home)


class LaggingArm(PaperArm):
    """Follows half by delay, half by a filter of first order; encoders are noisy, and it may hum when it moves."""

    def __init__(self, q: Array, rate: float, delay: float, noise: float, hum: float) -> None:
        super().__init__(q)
        self.rate = rate
        self._delay, self._noise, self._hum = delay, noise, hum
        self._rng = np.random.default_rng(0)

    def execute(
        self,
        trajectory: Trajectory,
        guard: ContactGuard | None = None,  # noqa: ARG002
        watch: MotionWatch | None = None,  # noqa: ARG002
    ) -> MotionReport:
        stamps = np.arange(0.0, trajectory.duration + 0.2, 1.0 / self.rate)
        q, late = np.tile(trajectory.q[0], (2, len(stamps), 1))
        q[:, 0] = np.interp(stamps, trajectory.times, trajectory.q[:, 0])
        late[:, 0] = np.interp(stamps - 0.5 * self._delay, trajectory.times, trajectory.q[:, 0])
        blend = 1.0 - np.exp(-2.0 / (self.rate * self._delay))
        measured = np.empty_like(q)
        measured[0] = q[0]
        for k in range(1, len(q)):
            measured[k] = measured[k - 1] + blend * (late[k] - measured[k - 1])
        moving = np.abs(np.gradient(q[:, 0], stamps)) > 1e-3
        measured[:, 0] += self._hum * moving * np.sin(2 * np.pi * 25.0 * stamps)
        measured += self._rng.normal(0.0, self._noise, measured.shape)
        return MotionReport(MotionOutcome.COMPLETED, stamps, q, measured, np.zeros((len(q), 6)))


def _series(rate: float, noise: float, hum_from: int | None = None) -> list[Trial]:
    @contextmanager
    def open_with(gain: float, lookahead: float) -> Iterator[Supervisor]:
        hum = hum_from is not None and PAIRS.index((gain, lookahead)) >= hum_from
        arm = LaggingArm(HOME, rate, lookahead + 0.01, noise, 6e-4 if hum else 0.0)
        yield Supervisor(arm, Bystander(), SLOW.robot, SLOW.config, lambda: SLOW.world)

    return list(tune(open_with, SLOW, 1))


@pytest.mark.parametrize(("rate", "noise"), [(500.0, 2e-5), (125.0, 1e-4)])
def test_the_lag_is_measured_through_the_encoders_noise(rate: float, noise: float) -> None:
    trials = _series(rate, noise)
    assert len(trials) == len(PAIRS) * len(SHARES), "nothing vibrates"
    for trial in trials:
        if trial.lookahead <= 0.1 and trial.figures.speed > 0.09:
            # Of a filter, a sine of 1.2 Hz shows a little less than the delay that it has at rest.
            assert trial.figures.lag == pytest.approx(trial.lookahead + 0.01, rel=0.1)
            assert trial.figures.noise == pytest.approx(noise, rel=0.3)
    best = recommend(trials)
    assert best is not None
    assert (best.gain, best.lookahead) == PAIRS[-1], "each is much faster than the one that precedes it"


def test_a_series_ends_at_the_first_vibration_and_keeps_away_from_it() -> None:
    trials = _series(500.0, 2e-5, hum_from=3)
    assert (trials[-1].gain, trials[-1].lookahead) == PAIRS[3]
    assert [trial.bad for trial in trials] == [False] * 9 + [True]
    best = recommend(trials)
    assert best is not None
    assert (best.gain, best.lookahead) == PAIRS[1]
    assert best.lag >= max(t.figures.lag for t in trials if t.gain == best.gain)


def test_an_arm_that_vibrates_from_the_first_gets_no_recommendation() -> None:
    assert recommend(_series(500.0, 2e-5, hum_from=0)) is None


def test_a_gentler_servo_that_is_as_fast_is_preferred() -> None:
    trials = _series(500.0, 2e-5)
    sharper = [Trial(2 * t.gain, t.lookahead, t.figures) for t in trials[-3:]]
    best = recommend([*trials, *sharper])
    assert best is not None
    assert best.gain == PAIRS[-1][0]
