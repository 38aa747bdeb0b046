"""Whatever a bring-up is asked for, the arm gets nothing that is faster than the caps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.paper_arm import Bystander, PaperArm
from tests.errors import raises
from tests.examples import examples, seldom
from tests.sim_backend.kinematics import line
from toolee_robot.control import Mode, Supervisor
from toolee_robot.control.motion.path_stop import stop_on_path
from toolee_robot.control.motion.touch_force import TouchSettings
from toolee_robot.errors import DeviceError, LimitError, TooleeError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ContactGuard, MotionOutcome, MotionReport, MotionWatch
from toolee_robot.station import sim_station
from toolee_robot.tasks.bring_up.acceleration import borne, raise_acceleration
from toolee_robot.tasks.bring_up.lag import PAIRS, SHARES, Trial, lag_motion, recommend, tune
from toolee_robot.tasks.bring_up.slow_motions import (
    ACCELERATION,
    RAMP,
    SPEED,
    Caps,
    MotionFrame,
    Place,
    SlowStation,
    jog_joint,
    plan_joints,
    plan_line,
    plan_to_place,
)
from toolee_robot.tasks.bring_up.touch import SPEED as TOUCH_SPEED
from toolee_robot.tasks.bring_up.touch import approach
from toolee_robot.types import Trajectory

STATION = sim_station()
HOME = np.array(STATION.scene.home)


class ListeningArm(PaperArm):
    """An arm on paper that keeps the trajectories that it was given. presses: force at rest after a contact [N]."""

    def __init__(self, q: Array) -> None:
        super().__init__(q)
        self.given: list[Trajectory] = []
        self.presses, self._touches = 1e4, False

    def state(self, max_age: float = 0.1) -> ArmState:
        state = super().state(max_age)
        return replace(state, wrench=np.array([0.0, 0.0, self.presses * self._touches, 0.0, 0.0, 0.0]))

    def execute(
        self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport:
        self.given.append(trajectory)
        report = super().execute(trajectory, guard, watch)
        self._touches = report.contact is not None
        return report


_number = st.one_of(st.floats(-0.3, 0.3), st.floats(), st.floats(-10.0, 10.0))
_three = st.tuples(_number, _number, _number)
_frame = st.sampled_from(list(MotionFrame))
_starts = st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6).map(lambda change: HOME + change)
_caps = st.one_of(st.just((SPEED, ACCELERATION)), st.tuples(st.floats(1e-3, 50.0), st.floats(1e-2, 500.0)))
_moves = st.one_of(
    st.builds(lambda joint, by: _jog(joint, by), st.integers(-1, 8), _number),
    st.builds(lambda to: _to(np.array(to)), st.tuples(*[_number] * 6)),
    st.builds(lambda change: _to(HOME + change), st.lists(st.floats(-1, 1), min_size=6, max_size=6)),
    st.builds(lambda along, frame: _line(along, frame), _three, _frame),
)
_touches = st.builds(
    lambda along, frame, speed, force: Approach(along, frame, speed, force),
    *(_three, _frame, _number, st.floats(0.1, 1e3)),
)
Plan = Callable[[SlowStation, Array], Trajectory]


@dataclass(frozen=True)
class Approach:
    """A guarded approach."""

    along: tuple[float, float, float]
    frame: MotionFrame = MotionFrame.BASE_LINK
    speed: float = TOUCH_SPEED
    force: float = 1.0

    def __call__(self, slow: SlowStation, q: Array) -> Trajectory:
        return plan_line(slow, q, np.array(self.along), self.frame, self.speed)


def _jog(joint: int, by: float) -> Plan:
    return lambda slow, q: plan_joints(slow, q, jog_joint(q, joint, by))


def _to(goal: Array) -> Plan:
    return lambda slow, q: plan_joints(slow, q, goal)


def _line(along: tuple[float, float, float], frame: MotionFrame) -> Plan:
    return lambda slow, q: plan_line(slow, q, np.array(along), frame)


def _transfer(place: Place) -> Plan:
    return lambda slow, q: plan_to_place(slow, q, place)


def _executed(plan: Plan, slow: SlowStation, q: Array) -> list[Trajectory]:
    """What an arm is given when the motion is carried out; nothing where it is refused."""
    arm = ListeningArm(q)
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    try:
        trajectory = plan(slow, q)
        if isinstance(plan, Approach):
            arm.meets = 0.5
            approach(supervisor, slow, trajectory, TouchSettings(plan.force, 0.024, plan.speed, None, 0.0, 12.0))
        else:
            supervisor.execute(trajectory)
    except TooleeError:
        pass
    return arm.given


def _assert_slow(trajectory: Trajectory, speed: float, acceleration: float) -> None:
    h = np.diff(trajectory.times)[:, None]
    assert np.abs(trajectory.qd).max() <= 1.001 * speed
    assert np.abs(trajectory.qdd).max() <= 1.001 * acceleration
    assert np.abs(np.diff(trajectory.q, axis=0) / h).max() <= 1.011 * speed, "between the samples"
    assert np.abs(np.diff(trajectory.qd, axis=0) / h).max() <= 1.05 * acceleration + 1e-3, "between the samples"


@examples(40)
@given(st.one_of(_moves, _touches), _starts, _caps)
def test_no_arguments_make_a_motion_faster_than_its_caps(plan: Plan, q: Array, caps: tuple[float, float]) -> None:
    slow = SlowStation.of(STATION, Caps(*caps))
    for trajectory in _executed(plan, slow, q):
        _assert_slow(trajectory, min(caps[0], 3.14), min(caps[1], STATION.arm.transfer_acceleration))


@examples(5)
@given(st.sampled_from([Place.HOME, Place.HANDOVER, Place.NAIL]), _starts)
def test_no_transfer_is_faster_than_the_caps(place: Place, q: Array) -> None:
    slow = SlowStation.of(STATION, Caps())
    for trajectory in _executed(_transfer(place), slow, q):
        _assert_slow(trajectory, SPEED, ACCELERATION)


@examples(30)
@given(st.integers(1, 6), st.floats(1e-3, 10.0), _caps)
def test_no_measurement_of_the_lag_is_faster_than_the_caps(joint: int, speed: float, caps: tuple[float, float]) -> None:
    slow = SlowStation.of(STATION, Caps(*caps))
    _assert_slow(lag_motion(HOME, joint, speed, slow.config.arm).trajectory, *caps)


@pytest.mark.parametrize(
    "plan",
    [
        _jog(3, 0.05),
        _line((0.0, 0.0, 0.05), MotionFrame.PENDANT_BASE),
        _line((0.0, 0.0, -0.02), MotionFrame.TOOL),
        Approach((0.0, 0.0, -0.05)),
        *seldom(*(_transfer(place) for place in (Place.HANDOVER, Place.NAIL, Place.VIEW))),
    ],
)
def test_what_a_bring_up_asks_for_is_carried_out(plan: Plan) -> None:
    given = _executed(plan, SlowStation.of(STATION, Caps()), HOME)
    assert len(given) == (2 if isinstance(plan, Approach) else 1)
    assert np.ptp(given[0].q, axis=0).max() > 0.01
    if isinstance(plan, Approach):
        np.testing.assert_allclose(given[1].q[-1], given[0].q[0], atol=1e-6)


def test_a_touch_that_feels_contacts_where_nothing_presses_goes_on_and_gives_up_after_three() -> None:
    slow = SlowStation.of(STATION, Caps())
    arm = ListeningArm(HOME)
    arm.meets, arm.presses = 0.2, 1.0
    plan = Approach((0.0, 0.0, -0.05))
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    with raises(DeviceError, code="device.force_noise"):
        approach(supervisor, slow, plan(slow, HOME), TouchSettings(8.0, 0.024, 0.01, None, 0.0, 12.0))
    heights = [slow.robot.arm.fk(trajectory.q[-1])[2, 3] for trajectory in arm.given]
    np.testing.assert_allclose(heights[:3], heights[0], atol=1e-6)
    np.testing.assert_allclose(arm.q, HOME, atol=1e-6)


def test_the_supervisor_itself_refuses_what_is_over_the_caps() -> None:
    """So that a mistake in a plan is none in a motion."""
    slow = SlowStation.of(STATION, Caps())
    arm = ListeningArm(HOME)
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    for change, duration, code in (
        (0.1, 1.5, "limit.velocity"),
        (0.01, 0.2, "limit.acceleration"),
        (0.001, 0.15, "limit.jerk"),
    ):
        with raises(LimitError, code=code):
            supervisor.execute(line([HOME, HOME + change], duration))
    assert not arm.given


def test_caps_only_lower_the_limits_of_a_station() -> None:
    slower = replace(STATION, arm=replace(STATION.arm, velocity=(0.05,) * 6, transfer_acceleration=0.5))
    arm = Caps(100.0, 1000.0).apply(slower).arm
    assert (arm.velocity, arm.transfer_acceleration, arm.acceleration) == ((0.05,) * 6, 0.5, (0.5,) * 6)
    fast = Caps(100.0, 1000.0).apply(STATION).arm
    assert fast.transfer_velocity_scale == STATION.arm.transfer_velocity_scale
    np.testing.assert_array_equal(fast.stop_acceleration, STATION.arm.stop_acceleration)


@pytest.mark.parametrize(("caps", "stop"), [(Caps(), 4 / 3), (Caps(0.5), 5.0), (Caps(0.05, 3.0), 4.0)])
def test_a_stop_from_the_cap_of_the_speed_ends_in_time(caps: Caps, stop: float) -> None:
    arm = caps.apply(STATION).arm
    assert arm.transfer_acceleration == caps.acceleration
    assert arm.stop_acceleration == pytest.approx(stop)
    end = 2.0 * RAMP
    t = np.arange(0.0, end, 0.002)
    q = HOME + caps.speed * t[:, None] * np.eye(6)[0]
    steady = Trajectory(t, q, np.full_like(q, caps.speed) * np.eye(6)[0], np.zeros_like(q))
    taken = len(list(stop_on_path(steady, 0.0, 0.002, arm.stop_acceleration, arm.stop_jerk))) * 0.002
    assert taken <= 1.1 * RAMP, "the jerk beside it"


def test_a_stop_on_a_gentle_step_brakes_no_harder_than_belongs_to_that_step() -> None:
    config = replace(STATION, arm=replace(STATION.arm, acceleration=(8.0,) * 6))
    slow = SlowStation.of(STATION, Caps())
    arm = ListeningArm(HOME)
    supervisor = Supervisor(arm, Bystander(), slow.robot, config, lambda: slow.world)
    supervisor.mode = Mode.UNATTENDED
    trials = list(raise_acceleration(supervisor, replace(slow, config=config), 1, 8.0))
    assert borne(trials) == {1: 8.0}
    assert [trial.acceleration for trial in trials] == [2.0, 4.0, 6.0, 8.0]
    for trial, motion in zip(trials, arm.given, strict=True):
        assert np.abs(motion.qdd).max() == pytest.approx(trial.acceleration)
        assert motion.braking is not None
        assert motion.braking.max() == pytest.approx(4 / 3 * trial.acceleration)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_a_cap_that_is_no_number_is_refused(value: float) -> None:
    for caps in ({"speed": value}, {"acceleration": value}):
        with raises(UserError, says="give a number of at least"):
            Caps(**caps)


SLOW = SlowStation.of(sim_station(), Caps())
HOME_SERVO_TUNING = np.array(SLOW.config.scene.home)


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
        arm = LaggingArm(HOME_SERVO_TUNING, rate, lookahead + 0.01, noise, 6e-4 if hum else 0.0)
        yield Supervisor(arm, Bystander(), SLOW.robot, SLOW.config, lambda: SLOW.world)

    return list(tune(open_with, SLOW, 1))


@pytest.mark.parametrize(("rate", "noise"), seldom((125.0, 1e-4), (500.0, 2e-5)))
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
