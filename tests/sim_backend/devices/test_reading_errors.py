"""Errors of the wrench in the directly simulated arm: those of its generation, and none where none is wanted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.robots import load_robot
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.ur_controller.profile import CB3, E_SERIES, ForceErrors
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, Payload

pytestmark = pytest.mark.sim

HOME = np.array(sim_station().scene.home)


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


@pytest.mark.parametrize(("model", "errors"), [(ArmModel.UR10, CB3.force), (ArmModel.UR10E, E_SERIES.force)])
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


def test_readings_are_drawn_from_the_seed_and_scale_with_the_size() -> None:
    def mean(size: float, seed: int) -> Array:
        with arm_at_rest(ArmModel.UR10, size, seed) as simulation:
            return np.asarray(forces(simulation, 0.4).mean(axis=0))

    exact, usual, larger = mean(0.0, 3), mean(1.0, 3), mean(2.0, 3)
    np.testing.assert_allclose(larger - exact, 2.0 * (usual - exact), atol=1e-6)
    np.testing.assert_allclose(usual, mean(1.0, 3), atol=1e-12)
    assert np.linalg.norm(usual - mean(1.0, 4)) > 0.5
    # The mounting plate (0.1 kg) is a part of the payload, and on the arm's side of the simulated sensor.
    np.testing.assert_allclose(exact, [0.0, 0.0, 0.981], atol=0.01)


def test_a_hand_that_weighs_far_more_than_the_job_was_told_is_no_offset() -> None:
    robot = load_robot()
    true = robot.hand_payload(robot.hand_open)
    with arm_at_rest(ArmModel.UR10, 0.0) as simulation:
        arm = simulation.station.arm
        arm.set_payload(Payload(true.mass - 1.5, true.center_of_mass))
        arm.zero_wrench()
        arm.set_payload(Payload(true.mass - 2.5, true.center_of_mass))
        simulation.station.clock.sleep(0.1)
        before = arm.state().wrench
        with raises(DeviceError, code="device.wrench_too_large"):
            arm.zero_wrench()
        np.testing.assert_allclose(arm.state().wrench, before, atol=0.5)
