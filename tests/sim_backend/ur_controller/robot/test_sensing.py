"""What a controller measures: noise that is reproducible, offsets, and what `zero_ftsensor` does to them."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.ur_controller.server.wire import robot
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import CB3, E_SERIES, Profile
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import ArmDynamics
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, UR10E, ControllerModel
from toolee_robot.sim_backend.ur_controller.robot_system import Robot

HARSH = [("UR10", CB3), ("UR10e", E_SERIES)]


def record(served: Robot, seconds: float) -> dict[str, Array]:
    rows: dict[str, list[Array]] = {"q": [], "qd": [], "force": []}
    for _ in range(round(seconds * served.model.rate)):
        served.step()
        rows["q"].append(served.reading.q)
        rows["qd"].append(served.reading.qd)
        rows["force"].append(served.reading.tcp_force)
    return {name: np.array(found) for name, found in rows.items()}


@pytest.mark.parametrize(("model", "profile"), HARSH, ids=["CB3", "e-Series"])
def test_noise_and_offset_at_rest_are_those_of_the_generation(model: str, profile: Profile) -> None:
    found = record(robot(model, "harsh"), 8.0)
    force = found["force"]
    assert force[:, :3].std(axis=0) == pytest.approx([profile.force.noise[0]] * 3, rel=0.25)
    offset = float(np.linalg.norm(force[:, :3].mean(axis=0)))
    assert abs(offset - profile.force.offset[0]) < np.sqrt(3) * profile.force.pose_drift[0] + 1.0
    assert found["q"].std(axis=0) == pytest.approx([profile.encoders.position] * 6, rel=0.15)
    assert found["qd"].std(axis=0) == pytest.approx([profile.encoders.velocity] * 6, rel=0.15)


def test_equal_seeds_give_equal_noise_and_others_other_noise() -> None:
    first, same, other = (record(robot("UR10e", "harsh", seed=seed), 0.2)["force"] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, same)
    assert not np.allclose(first, other)


def test_an_ideal_controller_measures_exactly() -> None:
    served = robot("UR10e")
    found = record(served, 0.2)
    np.testing.assert_array_equal(found["q"], np.tile(served.plant.q, (len(found["q"]), 1)))
    assert not found["force"].any()
    assert not found["qd"].any()


@pytest.mark.parametrize(("model", "zeroes"), [("UR10", False), ("UR10e", True)])
def test_zeroing_removes_the_offset_where_the_controller_can(model: str, zeroes: bool) -> None:
    served = robot(model, "harsh")
    before = np.linalg.norm(record(served, 4.0)["force"][:, :3].mean(axis=0))
    served.machine.zero_wrench()
    after = np.linalg.norm(record(served, 4.0)["force"][:, :3].mean(axis=0))
    if zeroes:
        assert after < 0.3 < before
    else:
        assert after == pytest.approx(before, abs=1.0)


def test_a_cb3_feels_its_own_motion_and_an_e_series_less() -> None:
    """The estimate from currents takes friction and inertia that it does not know for a force from outside."""
    swing = "def s():\n  movej([0.6, -1.2, 1.4, -1.5, -1.5, 0.4], 3, 1.5)\nend\n"
    felt = {}
    for model in ("UR10", "UR10e"):
        served = robot(model, "harsh", limits={"force": inf, "collision_torque": inf, "power": inf})
        still = record(served, 1.0)["force"][:, :3].mean(axis=0)
        served.program.upload(swing)
        felt[model] = float(np.linalg.norm(record(served, 0.6)["force"][:, :3] - still, axis=1).mean())
    assert felt["UR10"] > 1.5 * felt["UR10e"]


@given(
    model=st.sampled_from([UR10, UR10E]),
    q=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
    payload=st.floats(0.0, 5.0),
)
@examples(20)
def test_torques_at_rest_are_the_gradient_of_the_potential_energy(
    model: ControllerModel, q: list[float], payload: float
) -> None:
    gravity, cog = np.array([0.0, 0.0, 9.82]), np.array([0.02, -0.03, 0.1])

    def energy(at: Array) -> float:
        """From the momentum of lifting it: the height of the masses, integrated over a short way."""
        arm = ArmDynamics(model)
        arm.step(model, np.array(q), payload, cog, gravity, 1.0)
        return float(arm.step(model, at, payload, cog, gravity, 1.0).momentum @ gravity)

    arm = ArmDynamics(model)
    torques = arm.step(model, np.array(q), payload, cog, gravity, 0.002).torques
    h = 1e-6
    gradient = [(energy(q + h * e) - energy(q - h * e)) / (2 * h) for e in np.eye(6)]
    np.testing.assert_allclose(torques, gradient, atol=1e-4)


@given(
    model=st.sampled_from([UR10, UR10E]),
    q=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
    qd=st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6),
    qdd=st.lists(st.floats(-5.0, 5.0), min_size=6, max_size=6),
)
@examples(20)
def test_power_of_the_torques_is_the_change_of_the_energy(
    model: ControllerModel, q: list[float], qd: list[float], qdd: list[float]
) -> None:
    """Kinetic energy from the momenta of single masses would hide errors: it is had from the torques along a path."""
    dt, none = 1e-4, np.zeros(3)
    start, speed, change = np.array(q), np.array(qd), np.array(qdd)

    def torque_at(t: float, acceleration: Array, velocity: Array) -> Array:
        arm = ArmDynamics(model)
        found = np.zeros(6)
        for s in (t - dt, t, t + dt):
            path = start + velocity * s + 0.5 * acceleration * s * s
            found = arm.step(model, path, 1.0, none, none, dt).torques
        return found

    # T = 0.5 qd' M qd, with M qd from the torques of accelerating by qd at rest
    inertia = torque_at(0.0, speed, np.zeros(6))
    power = float(torque_at(0.0, change, speed) @ speed)
    h = 1e-4
    energy = []
    for t in (-h, h):
        velocity = speed + change * t
        at = start + speed * t + 0.5 * change * t * t
        arm = ArmDynamics(model)
        found = np.zeros(6)
        for s in (-dt, 0.0, dt):
            found = arm.step(model, at + 0.5 * velocity * s * s, 1.0, none, none, dt).torques
        energy.append(0.5 * float(found @ velocity))
    assert inertia @ speed >= -1e-6
    assert power == pytest.approx((energy[1] - energy[0]) / (2 * h), abs=0.02 * (1.0 + abs(power)))
