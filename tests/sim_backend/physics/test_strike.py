"""Strikes with the hammer in the hand: plausible drives, a wrist that gives way, a grip that keeps the tool."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.sim_backend.physics.energy_balance import driven_by
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover, plan_straight, plan_strike
from toolee_robot.control.motion.contact_force import strike_guard
from toolee_robot.end_effectors import Category
from toolee_robot.frames import inverse, rotation_angle
from toolee_robot.hal import MotionOutcome
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.station import sim_station
from toolee_robot.types import Payload

pytestmark = pytest.mark.sim

CONFIG = sim_station()
SPEED = 1.1  # [m/s]
SPEEDS = 1.06, 1.08, 1.10, 1.12, 1.14


@contextmanager
def holding(compliance: float) -> Iterator[SimStation]:
    """A station with a hammer in the hand."""
    robot = RobotModel.load()
    with SimStation.build(CONFIG, 0, SimOptions(compliance=compliance)) as simulation:
        station = simulation.station
        q, q_hand = station.arm.state().q_commanded, station.hand.state().joints.q
        station.arm.execute(plan_handover(robot, CONFIG, CollisionWorld(robot, CONFIG, q_hand), q, q_hand))
        assert station.person.request_handover("", 10.0)
        station.hand.close(8.0)
        assert station.person.release("", 10.0)
        X_hand_tool = inverse(simulation.world.X_base_hand()) @ simulation.world.X_base_tool()
        q_hand = station.hand.state().joints.q
        tool = simulation.tool
        station.arm.set_payload(robot.payload(q_hand, X_hand_tool, tool.mass, tool.center_of_mass))
        yield simulation


@pytest.fixture(scope="module")
def held() -> Iterator[SimStation]:
    with holding(0.0) as simulation:
        yield simulation


@pytest.mark.nightly
def test_strikes_drive_the_nail_by_the_hammers_energy_and_the_hand_keeps_it(held: SimStation) -> None:
    _strike_twice(held)


@pytest.mark.nightly
def test_strikes_are_simulated_faster_than_real_time(held: SimStation) -> None:
    """Planning included; nightly, since it is the machine's time that is compared."""
    simulated, cpu = _strike_twice(held)
    assert simulated > cpu


@pytest.mark.nightly
def test_with_elastic_joints_strikes_are_as_fast_and_drive_the_nail_about_as_far() -> None:
    """When in a control cycle the face meets the nail decides how soon the arm turns back."""
    with holding(0.0) as rigid, holding(1.0) as elastic:
        far, short = ([_strike_anew(station, speed) for speed in SPEEDS] for station in (elastic, rigid))
        np.testing.assert_allclose(far, short, rtol=0.1)
        assert np.mean(np.divide(far, short)) == pytest.approx(1.0, abs=0.07)
        fast, slow = ([strike.speed for strike in station.judge.strikes] for station in (elastic, rigid))
        np.testing.assert_allclose(fast, slow, rtol=0.01)


def _strike_anew(held: SimStation, speed: float) -> float:
    """Set the nail as it was at first and strike it; returns the drive [m]."""
    nail = held.world.nail
    nail.place(nail.spec.protrusion)
    return _strike(held, speed)


def _strike_twice(held: SimStation) -> tuple[float, float]:
    """Strike twice and check each strike; returns the simulated time and the processor's [s]."""
    simulated, cpu = -held.world.time, -time.process_time()
    for _ in range(2):
        _strike(held, SPEED)
    return simulated + held.world.time, cpu + time.process_time()


def _strike(held: SimStation, speed: float) -> float:
    """Strike and check the strike; returns by how far it drives the nail [m]."""
    robot, station, world = RobotModel.load(), held.station, held.world
    tool, X_tool_ee = held.tool, held.tool.ee(Category.HAMMER_HEAD).X_tool_ee
    swung = Payload(tool.mass, tool.center_of_mass).seen_from(inverse(X_tool_ee))
    X_before = inverse(world.X_base_hand()) @ world.X_base_tool()
    X_hand_ee = inverse(world.X_base_hand()) @ world.X_base_ee()
    q, q_hand = station.arm.state().q_commanded, station.hand.state().joints.q
    collisions = CollisionWorld(robot, CONFIG, q_hand, X_hand_ee)
    protrusion = world.nail.protrusion
    X_base_nail = CONFIG.work.X_base_nail(protrusion)
    state = q, q_hand, X_hand_ee, X_base_nail
    plan = plan_strike(robot, CONFIG, collisions, *state, tool=swung, speed=speed)
    station.arm.execute(plan.approach)
    wrist: list[float] = []
    held.observers.append(lambda sample, seen=wrist: seen.append(float(sample.q_hand[0])))  # type: ignore[misc]
    guard = strike_guard(CONFIG.strike, plan.contact_time)
    report = station.arm.execute(plan.strike, guard)
    station.clock.sleep(0.1)
    held.observers.clear()
    retract = plan_straight(robot, CONFIG, collisions, station.arm.state().q_commanded, 0.2)
    station.arm.execute(retract)
    station.clock.sleep(0.3)

    assert report.outcome is MotionOutcome.CONTACT
    strike = held.judge.strikes[-1]
    assert strike.hit
    assert strike.speed == pytest.approx(speed, rel=0.1)
    assert strike.offset_mm < 1.5
    assert strike.tilt_deg < 1.0
    free = driven_by(world.nail.spec, protrusion, strike.energy)
    # The hand behind the hammer adds to its own energy, the grip's compliance takes off: never a rigid weld's 3x.
    drive = float(protrusion - world.nail.protrusion)
    assert 0.6 * free < drive < 1.35 * free
    assert np.ptp(wrist) > 0.02  # the wrist gives way,
    moved = inverse(X_before) @ inverse(world.X_base_hand()) @ world.X_base_tool()
    assert np.linalg.norm(moved[:3, 3]) < 0.0015  # the grip hardly does
    assert rotation_angle(moved[:3, :3]) < np.deg2rad(1.0)
    assert station.hand.state().joints.q[0] == pytest.approx(q_hand[0], abs=0.01)  # and the wrist comes back
    assert station.hand.state().holding
    return drive


@pytest.mark.nightly
def test_after_the_strikes_the_nail_stays_where_it_is(held: SimStation) -> None:
    protrusion = held.world.nail.protrusion
    held.station.clock.sleep(0.5)
    assert held.world.nail.protrusion == pytest.approx(protrusion, abs=1e-5)
