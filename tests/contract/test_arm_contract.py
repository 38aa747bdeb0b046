"""What `hal.Arm` promises, asked of every arm: the simulated one, the UR driver on the controller stand-in as UR10 and
as UR10e, and with --hardware a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.contract.rigs import Rig
from tests.errors import raises
from tests.sim_backend.kinematics import line
from tests.stand_in import PATIENT
from toolee_robot.control.motion.trajectory_checks import START_TOLERANCE
from toolee_robot.errors import (
    DeviceError,
    EmergencyStopError,
    LatchedError,
    LimitError,
    MotionFaultError,
    ProtectiveStopError,
    StaleDataError,
    TrackingError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import Arm, ArmStatus, ContactGuard, MotionOutcome, MotionReport
from toolee_robot.types import Payload, Trajectory

AT_REST = 0.02  # [rad/s]


def needs_faults(rig: Rig) -> None:
    if not rig.faults:
        pytest.skip("needs a fault that nobody brings about on a robot")
    rig.disturbed = True


def stands(rig: Rig) -> None:
    _, qd = rig.true_joints()
    assert np.abs(qd).max() < AT_REST


def along(report: MotionReport, trajectory: Trajectory) -> Array:
    """Where on a straight joint line each command was, 0 to 1; asserts that all were on it."""
    a, way = trajectory.q[0], trajectory.q[-1] - trajectory.q[0]
    share = (report.q_commanded - a) @ way / (way @ way)
    np.testing.assert_allclose(report.q_commanded, a + share[:, None] * way, atol=1e-6)
    return share


def braked_within_limits(report: MotionReport, rig: Rig) -> None:
    """Along its path, forwards, and with no joint's deceleration over what the configuration allows."""
    qd = np.diff(report.q_commanded, axis=0) * rig.arm.rate
    qdd = np.diff(qd, axis=0) * rig.arm.rate
    assert np.abs(qdd).max() < 1.1 * max(*rig.limits.stop_acceleration, *rig.limits.acceleration)


def test_it_is_an_arm_at_its_rate(rig: Rig) -> None:
    assert isinstance(rig.arm, Arm)
    assert rig.arm.rate == rig.rate


def test_its_state_is_fresh_finite_and_ready(rig: Rig) -> None:
    state = rig.arm.state(max_age=0.5)
    assert state.status is ArmStatus.READY
    assert state.joints.q.shape == state.joints.qd.shape == state.q_commanded.shape == state.wrench.shape == (6,)
    assert np.all(np.isfinite(np.concatenate([state.joints.q, state.joints.qd, state.q_commanded, state.wrench])))
    assert 0.0 <= rig.now() - state.joints.stamp < 0.5
    np.testing.assert_allclose(state.joints.q, rig.true_joints()[0], atol=rig.reading)
    rig.sleep(0.1)
    assert rig.arm.state(max_age=0.5).joints.stamp > state.joints.stamp


def test_a_motion_is_driven_as_planned_and_reported_as_sent(rig: Rig) -> None:
    trajectory = rig.nudge()
    began = rig.now()
    report = rig.execute(trajectory)
    assert report.outcome is MotionOutcome.COMPLETED
    assert report.contact is None
    n = len(report.stamps)
    assert report.q_commanded.shape == report.q_measured.shape == report.wrenches.shape == (n, 6)
    share = along(report, trajectory)
    assert share[-1] == pytest.approx(1.0, abs=1e-6)
    assert np.diff(share).min() > -1e-9
    # Every sample of the path went out, each a cycle of the robot further on.
    assert n >= trajectory.duration * rig.rate
    k = np.arange(1, int(trajectory.duration * rig.rate))
    expected = np.array([trajectory.sample(t)[0] for t in k / rig.rate])
    np.testing.assert_allclose(report.q_commanded[k - 1], expected, atol=1e-6)
    assert np.median(np.diff(report.stamps)) == pytest.approx(1 / rig.rate, rel=0.2)
    assert began <= report.stamps[0]
    assert report.stamps[-1] <= rig.now() + 1e-9
    stands(rig)
    np.testing.assert_allclose(rig.true_joints()[0], trajectory.q[-1], atol=rig.tracking)
    np.testing.assert_allclose(report.q_measured[-1], trajectory.q[-1], atol=rig.tracking)
    np.testing.assert_array_equal(rig.start(), report.q_commanded[-1])


BREACHES: list[tuple[Callable[[Trajectory], Trajectory], str]] = [
    (lambda t: Trajectory(t.times, t.q + 0.05, t.qd, t.qdd), "limit.start"),
    (lambda t: Trajectory(t.times, t.q + 2 * START_TOLERANCE, t.qd, t.qdd), "limit.start"),
    (lambda t: Trajectory(t.times / 40, t.q, t.qd * 40, t.qdd * 1600), "limit.velocity"),
    (lambda t: Trajectory(t.times, np.where(t.q == t.q[-1], np.nan, t.q), t.qd, t.qdd), "limit.not_finite"),
    (lambda t: Trajectory(t.times, t.q, t.qd, np.where(t.qdd == t.qdd[1], np.inf, t.qdd)), "limit.not_finite"),
    (lambda t: Trajectory(t.times, t.q + np.linspace(0, 7, len(t.q))[:, None], t.qd, t.qdd), "limit.position"),
    (lambda t: Trajectory(t.times, *(np.hstack([a, a[:, :1]]) for a in (t.q, t.qd, t.qdd))), "limit.joint_count"),
]


@pytest.mark.parametrize(("change", "code"), BREACHES)
def test_what_breaks_a_limit_is_refused_and_nothing_moves(
    rig: Rig, change: Callable[[Trajectory], Trajectory], code: str
) -> None:
    q, _ = rig.true_joints()
    with raises(LimitError, code):
        rig.execute(change(rig.nudge()))
    rig.sleep(0.05)
    np.testing.assert_allclose(rig.true_joints()[0], q, atol=rig.reading)
    assert rig.arm.state(0.5).status is ArmStatus.READY


def test_a_start_within_the_tolerance_is_taken(rig: Rig) -> None:
    trajectory = rig.nudge(share=0.3)
    shifted = replace(trajectory, q=trajectory.q + 0.5 * START_TOLERANCE)
    assert rig.execute(shifted).outcome is MotionOutcome.COMPLETED
    np.testing.assert_array_equal(rig.start(), shifted.q[-1])


def test_a_contact_brakes_on_the_path(rig: Rig) -> None:
    needs_faults(rig)
    trajectory, guard = rig.contact()
    report = rig.execute(trajectory, guard)
    assert report.outcome is MotionOutcome.CONTACT
    assert report.contact is not None
    share = along(report, trajectory)
    assert 0.05 < share[-1] < 0.95
    assert np.diff(share).min() > -1e-9
    braked_within_limits(report, rig)
    first = int(np.argmax(np.linalg.norm(report.wrenches[:, :3], axis=1) > guard.force))
    np.testing.assert_allclose(report.contact.q, report.q_measured[first], atol=1e-9)
    stands(rig)
    # A contact is no fault: the arm goes on at once.
    back = line([report.q_commanded[-1], trajectory.q[0]], 1.0)
    assert rig.execute(back).outcome is MotionOutcome.COMPLETED


def test_no_contact_counts_before_its_time(rig: Rig) -> None:
    trajectory = rig.nudge(share=0.5)
    report = rig.execute(trajectory, ContactGuard(force=0.0, ignore_before=trajectory.duration + 1.0))
    assert report.outcome is MotionOutcome.COMPLETED


def test_stop_ends_a_motion_on_its_path(rig: Rig) -> None:
    trajectory = rig.nudge(1.5)
    rig.after(0.5, rig.arm.stop)
    report = rig.execute(trajectory)
    assert report.outcome is MotionOutcome.STOPPED
    share = along(report, trajectory)
    assert 0.02 < share[-1] < 0.9
    braked_within_limits(report, rig)
    stands(rig)
    # A stop is no fault either, and the next motion starts where this one ended.
    assert rig.execute(line([report.q_commanded[-1], trajectory.q[-1]], 1.0)).outcome is MotionOutcome.COMPLETED


def test_a_stop_at_rest_does_not_stop_what_comes_later(rig: Rig) -> None:
    rig.arm.stop()
    assert rig.execute(rig.nudge(0.5, share=0.3)).outcome is MotionOutcome.COMPLETED


def latched(rig: Rig) -> None:
    """Nothing moves before a reset."""
    q, _ = rig.true_joints()
    with pytest.raises(LatchedError):
        rig.execute(line([q, q + 0.05], 0.5))
    rig.sleep(0.05)
    np.testing.assert_allclose(rig.true_joints()[0], q, atol=1e-4)


def goes_on(rig: Rig) -> None:
    rig.recover()
    # Wherever it has come to rest: it is planned from there, and nothing jumps.
    np.testing.assert_allclose(rig.start(), rig.true_joints()[0], atol=rig.tracking)
    assert rig.execute(rig.nudge(0.5, share=0.3)).outcome is MotionOutcome.COMPLETED


@pytest.mark.parametrize("kind", ["protective", pytest.param("emergency", marks=pytest.mark.nightly)])
def test_a_stop_by_the_robot_latches_until_a_person_and_a_reset(rig: Rig, kind: str) -> None:
    needs_faults(rig)
    stop, error, status = {
        "protective": (rig.protective_stop, ProtectiveStopError, ArmStatus.PROTECTIVE_STOP),
        "emergency": (rig.emergency_stop, EmergencyStopError, ArmStatus.EMERGENCY_STOP),
    }[kind]
    trajectory = rig.nudge(1.5)
    rig.after(0.5, stop)
    with pytest.raises(error) as caught:
        rig.execute(trajectory)
    report = caught.value.report
    assert report is not None
    assert report.outcome is MotionOutcome.STOPPED
    assert along(report, trajectory)[-1] < 0.9
    rig.sleep(0.3)
    stands(rig)
    assert rig.arm.state(0.5).status is status
    latched(rig)
    with pytest.raises(DeviceError):
        rig.arm.reset()
    rig.make_ready()
    rig.sleep(0.1)
    latched(rig)
    goes_on(rig)


def test_a_stop_by_the_robot_at_rest_latches_too(rig: Rig) -> None:
    needs_faults(rig)
    rig.protective_stop()
    rig.sleep(0.2)
    assert rig.arm.state(0.5).status is ArmStatus.PROTECTIVE_STOP
    rig.make_ready()
    rig.sleep(0.2)
    latched(rig)
    goes_on(rig)


def test_an_arm_that_does_not_follow_is_stopped_on_its_path(rig: Rig) -> None:
    needs_faults(rig)
    trajectory = rig.nudge(1.5)
    rig.after(0.3, rig.hold_up)
    with pytest.raises(TrackingError) as caught:
        rig.arm.execute(trajectory, None, replace(PATIENT, tracking_error=0.1))
    report = caught.value.report
    assert report is not None
    assert along(report, trajectory)[-1] < 0.9
    braked_within_limits(report, rig)
    stands(rig)
    latched(rig)
    goes_on(rig)


def test_lost_data_stops_the_arm_and_old_states_raise(rig: Rig) -> None:
    needs_faults(rig)
    trajectory = rig.nudge(1.5)
    rig.after(0.5, rig.cut)
    with pytest.raises(StaleDataError) as caught:
        rig.execute(trajectory)
    assert isinstance(caught.value, MotionFaultError)
    rig.sleep(0.5)
    stands(rig)
    with pytest.raises(StaleDataError):
        rig.arm.state(max_age=0.2)
    with pytest.raises(LatchedError):
        rig.execute(rig.nudge(0.5))
    goes_on(rig)


def test_a_payload_is_taken_or_refused(rig: Rig) -> None:
    for mass in (-1.0, 50.0, float("nan")):
        with raises(LimitError, code="limit.payload_mass"):
            rig.arm.set_payload(Payload(mass))
    with raises(LimitError, code="limit.payload_not_finite"):
        rig.arm.set_payload(Payload(1.0, np.array([0.0, np.nan, 0.0])))
    if rig.faults:
        rig.arm.set_payload(rig.carried)
        assert rig.execute(rig.nudge(0.5, share=0.3)).outcome is MotionOutcome.COMPLETED


def test_a_zeroed_force_reads_zero_until_the_force_changes(rig: Rig) -> None:
    rig.arm.zero_wrench()
    wrenches = []
    for _ in range(round(rig.force_time / 0.01)):
        rig.sleep(0.01)
        wrenches.append(rig.arm.state(0.5).wrench)
    # A sensor's noise over this time, and what its offset drifts meanwhile.
    assert np.linalg.norm(np.mean(wrenches, axis=0)[:3]) < rig.zeroed


def test_a_force_is_not_zeroed_in_motion_nor_while_latched(rig: Rig) -> None:
    refused: list[DeviceError] = []

    def try_it() -> None:
        try:
            rig.arm.zero_wrench()
        except DeviceError as error:
            refused.append(error)

    rig.after(0.5, try_it)
    assert rig.execute(rig.nudge()).outcome is MotionOutcome.COMPLETED
    assert [error.code for error in refused] in (["not_ready.moving"], ["device.busy"])
    if rig.faults:
        needs_faults(rig)
        rig.protective_stop()
        rig.sleep(0.3)
        with raises(LatchedError, code="latched"):
            rig.arm.zero_wrench()


def test_leaving_the_context_stops_and_closes_the_arm(rig: Rig) -> None:
    """Last of all: the arm is entered again afterwards."""
    arm = rig.arm
    rig.after(0.3, arm.stop)
    assert rig.execute(rig.nudge()).outcome is MotionOutcome.STOPPED
    arm.__exit__(None, None, None)
    if rig.faults:  # a robot's joints are known from the open arm alone
        stands(rig)
    for use in (arm.state, arm.reset, lambda: rig.execute(line([np.zeros(6), np.full(6, 0.01)], 1.0))):
        with raises(DeviceError, code="device.closed"):
            use()
    arm.stop()
    arm.__enter__()
