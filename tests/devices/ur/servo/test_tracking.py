"""Errors and states from what the servo process has written down."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.kinematics import line
from toolee_robot.devices.ur.protocols.tcp import ControllerError
from toolee_robot.devices.ur.servo.messages import Cause
from toolee_robot.devices.ur.servo.motion import tracking_error
from toolee_robot.devices.ur.servo.report import arm_state, build_report, fault
from toolee_robot.devices.ur.servo.shared_memory import Column, ServoMemory, StateColumn, Word
from toolee_robot.devices.ur.status import ErrorLog
from toolee_robot.errors import ProtectiveStopError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import ServoConfig, SupervisorConfig, servo_lag, sim_station

NAN = float("nan")
PROTECTIVE_STOP = 1 << 2


def state(ratios: tuple[float, float], safety: int = PROTECTIVE_STOP) -> Array:
    numbers = np.zeros(StateColumn.COUNT)
    numbers[StateColumn.SAFETY_BITS], numbers[StateColumn.ROBOT_MODE] = safety, 7
    numbers[StateColumn.RATIOS], numbers[StateColumn.DIGITAL_INPUTS] = ratios, 0b101
    return numbers


@pytest.fixture
def memory() -> Iterator[ServoMemory]:
    shared = ServoMemory.create(1.0)
    yield shared
    shared.close()


def test_a_state_has_the_ratios_and_inputs_that_the_controller_reports() -> None:
    told = arm_state(state((0.25, 0.5), safety=1))
    assert (told.status, told.digital_inputs) == (ArmStatus.READY, 0b101)
    assert (told.position_deviation_ratio, told.collision_ratio) == (0.25, 0.5)
    untold = arm_state(state((NAN, 0.5)))
    assert (untold.position_deviation_ratio, untold.collision_ratio) == (None, 0.5)


def test_a_state_has_the_safety_bits_and_the_code_that_explains_a_stop() -> None:
    log = ErrorLog("127.0.0.95", HostClock())  # nobody answers there
    try:
        assert arm_state(state((NAN, NAN)), log).error_code is None
        log._errors += [ControllerError(204, 3, 2, ""), ControllerError(157, 4, 3, ""), ControllerError(191, 7, 3, "")]
        told = arm_state(state((NAN, NAN)), log)
    finally:
        log.close()
    assert (told.safety_bits, told.error_code) == (PROTECTIVE_STOP, "C157A4")


def test_a_report_has_velocities_torques_currents_and_safety_bits(memory: ServoMemory) -> None:
    drawn = np.random.default_rng(0).normal(0.0, 1.0, (4, 18))
    memory.rows[:4, Column.QD], memory.rows[:4, Column.DRIVES] = drawn[:, :6], drawn[:, 6:]
    memory.rows[:4, Column.SAFETY_BITS] = 1, 1, 0x404, 0x404
    memory.words[Word.ROWS] = 4
    report = build_report(memory, Cause.STOPPED_BY_ROBOT)
    for told, rows in zip((report.qd_measured, report.torques, report.currents), np.split(drawn, 3, 1), strict=True):
        assert told is not None
        np.testing.assert_array_equal(told, rows)
    assert report.safety_bits is not None
    assert report.safety_bits.tolist() == [1, 1, 0x404, 0x404]


@pytest.mark.parametrize("said", [NAN, 0.0])
def test_torques_and_currents_that_a_controller_does_not_know_are_not_reported(
    memory: ServoMemory, said: float
) -> None:
    memory.rows[:3, Column.DRIVES] = said
    memory.words[Word.ROWS] = 3
    report = build_report(memory, Cause.NONE)
    assert (report.torques, report.currents) == (None, None)


@pytest.mark.parametrize(
    ("swing", "now", "code"),
    [
        ((0.4, 0.3), (0.4, 0.3), "protective_stop"),
        ((NAN, NAN), (NAN, NAN), "protective_stop"),
        ((1.0, 0.7), (0.1, 0.1), "protective_stop.position_deviation"),
        ((0.3, 0.2), (0.5, 1.3), "protective_stop.collision"),
        ((NAN, 1.1), (NAN, 0.0), "protective_stop.collision"),
    ],
)
def test_a_ratio_that_reached_its_limit_names_the_reason_of_a_protective_stop(
    memory: ServoMemory, swing: tuple[float, float], now: tuple[float, float], code: str
) -> None:
    memory.rows[:3, Column.RATIOS] = np.where(np.isnan(swing), NAN, 0.1)
    memory.rows[1, Column.RATIOS] = swing
    memory.words[Word.ROWS] = 3
    report = build_report(memory, Cause.STOPPED_BY_ROBOT)
    error = fault(Cause.STOPPED_BY_ROBOT, arm_state(state(now)), report)
    assert isinstance(error, ProtectiveStopError)
    assert error.code == code
    for column, ratios in enumerate((report.position_deviation_ratios, report.collision_ratios)):
        if np.isnan(swing[column]):
            assert ratios is None
        else:
            assert ratios is not None
            assert ratios.max() == swing[column]


def test_a_protective_stop_at_rest_is_named_by_the_state_alone() -> None:
    assert fault(Cause.STOPPED_BY_ROBOT, arm_state(state((0.0, 2.0))), None).code == "protective_stop.collision"


@pytest.mark.parametrize(
    ("cause", "words"),
    [(Cause.DATA, "(up to 48 ms old)"), (Cause.OVERRUN, "by up to 31 ms,")],
)
def test_what_was_late_is_told_with_the_time(memory: ServoMemory, cause: Cause, words: str) -> None:
    memory.rows[:3, Column.SENT] = 5.0, 5.008, 5.016
    memory.rows[:3, Column.SEEN] = 4.996, 4.96, 5.012
    memory.rows[:3, Column.LATENESS] = 0.0001, 0.0314, 0.0002
    memory.words[Word.ROWS] = 3
    report = build_report(memory, cause)
    assert (report.lateness, report.data_age) == pytest.approx((0.0314, 0.048))
    assert words in str(fault(cause, arm_state(state((0.0, 0.0))), report))
    assert "up to" not in str(fault(cause, arm_state(state((0.0, 0.0))), None)), "at rest nothing was measured"


def test_a_motion_without_a_command_was_not_late(memory: ServoMemory) -> None:
    memory.words[Word.ROWS] = 0
    report = build_report(memory, Cause.OVERRUN)
    assert (report.lateness, report.data_age) == (0.0, 0.0)


LIMITS = sim_station().arm
BOUND = SupervisorConfig().tracking_error
FULL_TRANSFER = LIMITS.transfer_velocity_scale * max(LIMITS.velocity)  # [rad/s] of the fastest joint


def driven(rate: float, speed: float) -> tuple[Array, Array]:
    """Times [s] and commands (n, 6) [rad] of a motion whose fastest joint reaches `speed`, and of its standstill."""
    path = line([np.zeros(6), np.array([1.0, 0.5, -0.5, 0.2, -0.8, 0.9])], 1.0)
    duration = float(np.abs(path.qd).max()) / speed
    times = np.arange(0.0, duration + 0.5, 1.0 / rate)
    return times, np.array([path.sample(t / duration)[0] for t in times])


def worst(times: Array, commands: Array, measured: Array, lag: float) -> float:
    seen = times + 1e-4
    return max(
        tracking_error(times[: k + 1], commands[: k + 1], seen[k], measured[k], lag) for k in range(0, len(times), 4)
    )


def follower(times: Array, commands: Array, delay: float, constant: float) -> Array:
    """What a servo measures that delays its commands [s] and follows them to the first order with a constant [s]."""
    late = np.array([np.interp(times - delay, times, joint) for joint in commands.T]).T
    q, step = late.copy(), times[1] - times[0]
    for k in range(1, len(q)):
        q[k] = q[k - 1] + (late[k] - q[k - 1]) * -np.expm1(-step / max(constant, 1e-6))
    return q


@examples(15)
@given(rate=st.sampled_from([125.0, 500.0]), share=st.floats(0.0, 1.0), part=st.floats(0.0, 1.0))
@example(rate=125.0, share=1.0, part=0.0)
@example(rate=500.0, share=1.0, part=0.0)
def test_a_servo_within_its_assumed_lag_drives_a_transfer_at_full_speed(rate: float, share: float, part: float) -> None:
    servo = ServoConfig()
    lag = servo_lag(servo, rate)
    times, commands = driven(rate, FULL_TRANSFER)
    measured = follower(times, commands, part * share * lag, (1.0 - part) * share * lag)
    assert worst(times, commands, measured, lag) < BOUND


@pytest.mark.parametrize(("rate", "lag"), [(500.0, 0.034), (125.0, 0.054)])
def test_a_measured_lag_is_enough_for_a_strike(rate: float, lag: float) -> None:
    times, commands = driven(rate, 2.09)
    assert worst(times, commands, follower(times, commands, lag, 0.0), lag) < 1e-3
    assert worst(times, commands, follower(times, commands, lag + 0.05, 0.0), lag) > BOUND, "it may lag no more"


@examples(15)
@given(rate=st.sampled_from([125.0, 500.0]), joint=st.integers(0, 5), off=st.sampled_from([-0.1, 0.1]))
def test_a_joint_that_is_elsewhere_is_found_at_rest_whatever_the_lag(rate: float, joint: int, off: float) -> None:
    times, commands = driven(rate, FULL_TRANSFER)
    measured = commands.copy()
    measured[-5:, joint] += off
    assert worst(times[-200:], commands[-200:], measured[-200:], servo_lag(ServoConfig(), rate)) > BOUND


def test_before_the_first_command_nothing_is_behind() -> None:
    assert tracking_error(np.zeros(0), np.zeros((0, 6)), 1.0, np.ones(6), 0.1) == 0.0
