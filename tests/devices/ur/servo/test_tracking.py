"""The tracking check on a servo that lags as a real one does: delayed, or smoothed, or both."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.kinematics import line
from toolee_robot.devices.ur.servo.tracking import tracking_error
from toolee_robot.frames import Array
from toolee_robot.station import ServoConfig, SupervisorConfig, servo_lag, sim_station

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
