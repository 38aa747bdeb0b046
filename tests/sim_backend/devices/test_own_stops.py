"""The simulated arm stops by itself, for the reasons for which the controller stand-in does in the same world."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.errors import DeviceError, LatchedError, ProtectiveStopError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus, MotionOutcome, MotionWatch
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.arm import RATE, SimArm
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.sim_backend.ur_controller.profile import CB3, E_SERIES, profile
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.safety_system import SafetyMode
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.world_plant import WorldPlant
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, Trajectory

pytestmark = pytest.mark.sim

HOME = np.array(sim_station().scene.home)
BASE = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
both = pytest.mark.parametrize("model", list(ArmModel))


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
@pytest.mark.parametrize("force", [[0.0, 0.0, 170.0], [0.0, 140.0, 0.0], [-400.0, 0.0, 0.0]])
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


def test_without_errors_it_stops_as_an_ideal_controller_does() -> None:
    """By the force and the deviation, not by the torque at a joint."""
    for force, code in (([0.0, 145.0, 0.0], None), ([0.0, 160.0, 0.0], "C191A7")):
        with station(errors=0.0) as simulation:
            push(simulation, np.array(force), 0.2, 0.6)
            simulation.station.clock.sleep(0.5)
            assert arm_of(simulation).state().error_code == code


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


def test_what_gears_give_way_is_compensated_and_far_from_a_stop() -> None:
    with station(ArmModel.UR10E, compliance=1.0) as simulation:
        arm = arm_of(simulation)
        report = arm.execute(turn(arm.state().q_commanded, 0.8, 1.0))
        assert report.position_deviation_ratios is not None
        assert report.position_deviation_ratios.max() < 0.05


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
