"""The simulated arm: what a wrong payload leaves in its force is gone once it was zeroed; when a motion ends."""

from __future__ import annotations

import numpy as np
import pytest

from tests.contract.rigs import sim_rig
from tests.errors import raises
from toolee_robot.control import RobotModel
from toolee_robot.errors import NotReadyError
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.arm import HOLD_TIME, RATE, STANDSTILL
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.station import sim_station
from toolee_robot.types import Payload, Trajectory

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


@pytest.mark.parametrize("compliance", [0.0, 1.0])
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
