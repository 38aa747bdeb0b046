"""The simulated arm: what a wrong payload leaves in its force is gone once it was zeroed; when a motion ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from tests.contract.rigs import sim_rig
from tests.errors import raises
from tests.examples import seldom
from toolee_robot.control import RobotModel
from toolee_robot.errors import DeviceError, LatchedError, NotReadyError, ProtectiveStopError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus, MotionOutcome, MotionWatch
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.arm import HOLD_TIME, RATE, STANDSTILL, SimArm
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.sim_backend.ur_controller.profile import CB3, E_SERIES, ForceErrors, profile
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.safety_system import SafetyMode
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.world_plant import WorldPlant
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, Payload, Trajectory

pytestmark = pytest.mark.sim


def test_a_zeroed_force_reading_has_no_offset_until_the_payload_changes() -> None:
    hand = RobotModel.of_station(sim_station()).description
    right = hand.hand_payload(hand.hand_open)
    with sim_rig() as rig:

        def force() -> float:
            rig.sleep(0.1)
            return float(np.linalg.norm(rig.arm.state().wrench[:3]))

        rig.arm.set_payload(Payload(right.mass - 0.5, right.center_of_mass))
        assert force() > 3.0
        rig.arm.zero_wrench()
        assert force() < 0.5
        rig.arm.set_payload(right)
        assert force() == pytest.approx(0.5 * 9.81, abs=0.5)
        refused: list[str] = []

        def try_it() -> None:
            with raises(NotReadyError, code="not_ready.moving"):
                rig.arm.zero_wrench()
            refused.append("moving")

        rig.after(0.5, try_it)
        rig.execute(rig.nudge())
        assert refused == ["moving"]


def test_a_motion_ends_when_a_ringing_arm_has_stood_for_a_while() -> None:
    """It is pushed while it brakes, and rings; it stands for a moment at every turning point."""
    options = SimOptions(q_start=np.array(sim_station().scene.home), hands_over=False, compliance=1.0)
    with SimStation.build(sim_station(), 0, options) as simulation:
        arm, world = simulation.station.arm, simulation.world
        q = arm.state().q_commanded
        hold = Trajectory(np.array([0.0, 0.2]), np.array([q, q]), np.zeros((2, 6)), np.zeros((2, 6)))
        speeds: list[tuple[float, float]] = []

        def push(_dt: float) -> None:
            body, link = world.robot_body, world.robot.palm
            if world.time < 0.2:
                at = world.robot.link_pose(link)[:3, 3].tolist()
                force = [0.0, 0.0, 100.0]
                pb.applyExternalForce(body, link, force, at, pb.WORLD_FRAME, physicsClientId=world.client)
            speeds.append((world.time, float(np.abs(world.robot.arm_state()[1]).max())))

        world.before_step.append(push)
        arm.execute(hold)
        end = world.time
        assert 0.2 + 2 * HOLD_TIME < end < 1.0
        seen = np.array(speeds)
        last = seen[seen[:, 0] >= end - HOLD_TIME + 1 / RATE, 1]
        assert last.max() < 1.2 * STANDSTILL, "the speed is looked at once a cycle"
        assert seen[seen[:, 0] > 0.21, 1].max() > 3 * STANDSTILL
        simulation.station.clock.sleep(0.3)
        assert np.array(speeds)[len(seen) :, 1].max() < 1.2 * STANDSTILL


@pytest.mark.parametrize("compliance", seldom(1.0, 0.0))
def test_a_motion_is_reported_with_velocities_and_the_torques_that_the_controller_computes(compliance: float) -> None:
    options = SimOptions(q_start=np.array(sim_station().scene.home), hands_over=False, compliance=compliance)
    with SimStation.build(sim_station(), 0, options) as simulation:
        arm = simulation.station.arm
        q = arm.state().q_commanded
        times = np.linspace(0.0, 0.4, 81)
        s = (times / 0.4)[:, None]
        turn = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
        path = q + turn * (10 * s**3 - 15 * s**4 + 6 * s**5)
        velocity = turn * 30 * (s - s**2) ** 2 / 0.4
        acceleration = turn * (60 * s - 180 * s**2 + 120 * s**3) / 0.4**2
        report = arm.execute(Trajectory(times, path, velocity, acceleration))
    assert report.qd_measured is not None
    moved = np.cumsum(report.qd_measured, axis=0)[-1] / RATE
    assert moved[0] == pytest.approx(0.1, abs=2e-3)
    if compliance == 0.0:
        assert report.torques is None, "joints that are exact have no torques"
    else:
        assert report.torques is not None
        assert report.torques.shape == report.q_measured.shape
        gravity = report.torques[-1]
        assert 20.0 < abs(gravity[1]) < 330.0, "the shoulder carries the arm"
        assert np.abs(report.torques[:, 0] - gravity[0]).max() > 1.0, "the base accelerates"
    assert report.currents is None


HOME = np.array(sim_station().scene.home)
BASE = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
both = pytest.mark.parametrize("model", seldom(*ArmModel))


@contextmanager
def station(model: ArmModel = ArmModel.UR10, errors: float = 1.0, compliance: float = 0.0) -> Iterator[SimStation]:
    """A station whose arm carries its hand alone."""
    config = sim_station()
    config = replace(config, arm=replace(config.arm, model=model))
    options = SimOptions(q_start=HOME, hands_over=False, wrench_errors=errors, compliance=compliance)
    with SimStation.build(config, 0, options) as simulation:
        yield simulation


def arm_of(simulation: SimStation) -> SimArm:
    assert isinstance(simulation.station.arm, SimArm)
    return simulation.station.arm


def push(simulation: SimStation, force: Array, start: float, end: float) -> None:
    """Push the flange from start to end [s] with a force (3,) [N], axes of `base`."""
    world = simulation.world

    def act(_dt: float) -> None:
        if start <= world.time < end:
            body, link = world.robot_body, world.robot.sensor_link
            at = world.robot.link_pose(link)[:3, 3].tolist()
            pb.applyExternalForce(body, link, force.tolist(), at, pb.WORLD_FRAME, physicsClientId=world.client)

    world.before_step.append(act)


def turn(q: Array, way: float, duration: float) -> Trajectory:
    """Turn the base by `way` [rad], at rest at both ends."""
    times = np.linspace(0.0, duration, 201)
    s = (times / duration)[:, None]
    rows = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * (s - s**2) ** 2, 60 * s - 180 * s**2 + 120 * s**3
    path, qd, qdd = (way * BASE * row / duration**i for i, row in enumerate(rows))
    return Trajectory(times, q + path, qd, qdd)


@both
@pytest.mark.parametrize("force", seldom([0.0, 0.0, 170.0], [0.0, 140.0, 0.0], [-400.0, 0.0, 0.0]))
def test_it_stops_for_the_stand_ins_reason_at_its_time(model: ArmModel, force: list[float]) -> None:
    wrench = np.array(force)
    with station(model) as simulation:
        arm = arm_of(simulation)
        push(simulation, wrench, 0.2, 0.6)
        stamps: list[float] = []
        while arm.state().status is ArmStatus.READY and simulation.world.time < 0.6:
            simulation.station.clock.sleep(1.0 / RATE)
            stamps.append(simulation.world.time)
        code, said = arm.state().error_code, ""
        if code is not None:
            with pytest.raises(LatchedError) as e:
                arm.execute(turn(arm.state().q_commanded, 0.1, 1.0))
            said = str(e.value)
    with station(model) as simulation:
        push(simulation, wrench, 0.2, 0.6)
        served = Robot(MODELS[model.value], WorldPlant(simulation.world, MODELS[model.value].period),
                       profile=profile("harsh", MODELS[model.value].e_series))  # fmt: skip
        hand = simulation.world.robot.robot.hand_payload(simulation.world.robot.robot.hand_open)
        served.machine.set_payload(hand.mass, hand.center_of_mass.tolist())
        while served.safety.mode is SafetyMode.NORMAL and simulation.world.time < 0.6:
            served.step()
        reason, end = served.safety.reason, simulation.world.time
    if code is None:
        assert reason == "", "neither stops"
    else:
        assert reason.partition("(")[0] in said, (reason, said)
        assert reason.startswith(f"{code}: ")
        assert stamps[-1] == pytest.approx(end, abs=2.0 / RATE)


@both
def test_a_stop_in_motion_brakes_as_the_controller_does_and_needs_a_person(model: ArmModel) -> None:
    profiled = {ArmModel.UR10: CB3, ArmModel.UR10E: E_SERIES}[model]
    with station(model) as simulation:
        arm, clock = arm_of(simulation), simulation.station.clock
        clock.sleep(0.1)
        q = arm.state().q_commanded
        push(simulation, np.array([0.0, 0.0, 400.0]), 0.6, 0.7)
        with pytest.raises(
            ProtectiveStopError, match=r"protective stop: C1\d+A\d: .*; the arm has stopped and is"
        ) as e:
            arm.execute(turn(q, 0.8, 1.0), None, MotionWatch(tracking_error=1.0))
        report = e.value.report
        assert report is not None
        assert report.outcome is MotionOutcome.STOPPED
        assert report.commands is not None
        sent = report.q_commanded[: report.commands, 0]
        assert np.all(report.q_commanded[report.commands :, 0] == sent[-1]), "it was sent no more"
        speed = (sent[-1] - sent[-2]) * RATE
        braked = report.q_measured[-1, 0] - sent[-1]
        assert speed > 0.8
        # v^2 / 2a, less half a cycle's way for set-points that change once a cycle
        assert braked == pytest.approx(speed * speed / (2.0 * profiled.stops.protective) - 0.5 * speed / RATE, abs=2e-3)
        state = arm.state()
        assert state.status is ArmStatus.PROTECTIVE_STOP
        assert state.error_code is not None
        assert state.error_code in str(e.value)
        np.testing.assert_array_equal(state.q_commanded, report.q_commanded[-1])
        with pytest.raises(LatchedError, match=state.error_code):
            arm.execute(turn(q, 0.1, 1.0))
        with raises(DeviceError, code="device.robot_status"):
            arm.reset()
        arm.make_ready()
        with pytest.raises(LatchedError):
            arm.execute(turn(q, 0.1, 1.0))
        arm.reset()
        clock.sleep(0.1)
        report = arm.execute(turn(arm.state().q_commanded, -0.2, 1.0))
        assert report.outcome is MotionOutcome.COMPLETED
        assert report.commands is None
        assert arm.state().error_code is None


def test_a_joint_off_its_path_stops_it_where_the_program_does_not_look() -> None:
    with station() as simulation:
        arm, clock = arm_of(simulation), simulation.station.clock
        clock.sleep(0.1)
        q = arm.state().q_commanded
        arm.block_joint(0)
        with pytest.raises(ProtectiveStopError, match=r"C153A0: Position deviates from path: Base"):
            arm.execute(turn(q, 0.3, 1.0), None, MotionWatch(tracking_error=1.0))
        arm.make_ready()
        arm.reset()
        assert arm.execute(turn(arm.state().q_commanded, 0.1, 1.0)).outcome is MotionOutcome.COMPLETED


@pytest.mark.parametrize(("model", "errors"), [(ArmModel.UR10, 1.0), (ArmModel.UR10E, 0.0), (ArmModel.UR10E, 1.0)])
def test_ratios_are_told_by_the_arms_whose_controller_tells_them(model: ArmModel, errors: float) -> None:
    with station(model, errors) as simulation:
        arm = arm_of(simulation)
        push(simulation, np.array([0.0, 0.0, 50.0]), 0.2, 2.0)
        report = arm.execute(turn(arm.state().q_commanded, 0.2, 1.0))
        state = arm.state()
    if (model, errors) != (ArmModel.UR10E, 1.0):
        assert state.position_deviation_ratio is state.collision_ratio is None
        assert report.position_deviation_ratios is report.collision_ratios is None
        return
    assert state.position_deviation_ratio is not None
    assert state.collision_ratio is not None
    assert report.position_deviation_ratios is not None
    assert report.collision_ratios is not None
    assert 0.0 <= state.position_deviation_ratio < 0.2
    assert 0.1 < state.collision_ratio < 1.0
    assert report.collision_ratios.shape == report.position_deviation_ratios.shape == report.stamps.shape
    assert report.collision_ratios[-1] > 2.0 * report.collision_ratios[5]


@contextmanager
def arm_at_rest(model: ArmModel, size: float, seed: int = 0) -> Iterator[SimStation]:
    """A station whose arm stands and carries nothing but the hand, which it knows."""
    config = sim_station()
    config = replace(config, arm=replace(config.arm, model=model))
    options = SimOptions(q_start=HOME, hands_over=False, wrench_errors=size)
    with SimStation.build(config, seed, options) as simulation:
        yield simulation


def forces(simulation: SimStation, duration: float) -> Array:
    """Readings of the force, one a cycle, (N, 3) [N]."""
    arm, clock = simulation.station.arm, simulation.station.clock
    readings = []
    for _ in range(round(duration * arm.rate)):
        clock.sleep(1.0 / arm.rate)
        readings.append(arm.state().wrench[:3])
    return np.array(readings)


@pytest.mark.parametrize(("model", "errors"), seldom((ArmModel.UR10, CB3.force), (ArmModel.UR10E, E_SERIES.force)))
def test_an_arm_reads_the_noise_and_the_offset_of_its_generation(model: ArmModel, errors: ForceErrors) -> None:
    with arm_at_rest(model, 1.0) as simulation:
        rest = forces(simulation, 3.0)
        noise = np.sqrt(np.mean(np.var(rest, axis=0)))
        assert noise == pytest.approx(errors.noise[0], rel=0.2)
        # The drift with the pose is at most its size along each axis.
        offset = np.linalg.norm(rest.mean(axis=0))
        assert abs(offset - errors.offset[0]) < np.sqrt(3.0) * errors.pose_drift[0] + noise
        simulation.station.arm.zero_wrench()
        zeroed = forces(simulation, 3.0)
        assert np.linalg.norm(zeroed.mean(axis=0)) < 0.5 * errors.offset[0]
        assert np.sqrt(np.mean(np.var(zeroed, axis=0))) == pytest.approx(errors.noise[0], rel=0.2)
