"""Elastic joints of the arm: as soft as they say, passive, and what they change in a strike."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

from tests.examples import seldom
from toolee_robot.frames import Array, cross
from toolee_robot.robots import RobotDescription, load_robot
from toolee_robot.sim_backend.physics.bodies import IMPACT, StepSettings, pb
from toolee_robot.sim_backend.physics.robot_body import STIFFNESS, JointSprings, RobotBody
from toolee_robot.sim_backend.world import NORMAL
from toolee_robot.station import load_station, sim_station
from toolee_robot.types import Payload

pytestmark = pytest.mark.sim

HOME = np.array(sim_station().scene.home)
MOUNT = load_station(Path(__file__).parents[3] / "examples" / "mount.yaml").hand
assert MOUNT.mount is not None
LIGHT = replace(MOUNT, mount=replace(MOUNT.mount, mass=0.4, clamp_mass=0.1))
ROBOTS = {"shadow": load_robot(), "mount": load_robot(hand=MOUNT), "light mount": load_robot(hand=LIGHT)}
POSES = np.random.default_rng(5).uniform(-np.pi, np.pi, (8, 6))


@contextmanager
def elastic_arm(
    robot: RobotDescription, q: Array = HOME, gravity: float = -9.81, size: float = 1.0, settings: StepSettings = NORMAL
) -> Iterator[tuple[RobotBody, JointSprings]]:
    client = pb.connect(pb.DIRECT)
    try:
        pb.setGravity(0.0, 0.0, gravity, physicsClientId=client)
        settings.apply(client)
        body = RobotBody(client, robot, q, robot.hand_open, size, NORMAL.time_step)
        assert body._elastic is not None
        yield body, body._elastic
    finally:
        pb.disconnect(client)


def run(body: RobotBody, seconds: float, settings: StepSettings = NORMAL) -> None:
    for _ in range(round(seconds / settings.time_step)):
        body.before_step(settings.time_step)
        pb.stepSimulation(physicsClientId=body._client)


def kick(body: RobotBody, q: Array, qd: Array) -> None:
    for joint, position, speed in zip(body._arm, q, qd, strict=True):
        pb.resetJointState(body.body, joint, position, speed, physicsClientId=body._client)


def test_at_rest_the_controller_compensates_the_weight_that_it_knows() -> None:
    with elastic_arm(ROBOTS["shadow"]) as (body, springs):
        run(body, 1.0)
        q, qd = body.arm_state()
        np.testing.assert_allclose(q, HOME, atol=1e-9)
        assert np.abs(qd).max() < 1e-9
        # 1 kg more than it knows, at the flange: the joints give way by its moment over their stiffness.
        known = springs.model.payload
        body.set_payload(Payload(known.mass - 1.0, known.center_of_mass))
        body.command_arm(HOME, np.zeros(6))
        run(body, 2.0)
        less = springs.model.at(HOME, np.zeros(6), np.zeros(6))
        body.set_payload(known)
        sag = (less - springs.model.at(HOME, np.zeros(6), np.zeros(6))) / springs.stiffness
        np.testing.assert_allclose(body.arm_state()[0] - HOME, sag, rtol=0.02, atol=1e-7)
        assert 2e-5 < np.abs(sag).max() < 5e-4


def test_a_force_displaces_the_hand_by_force_over_stiffness() -> None:
    with elastic_arm(ROBOTS["mount"]) as (body, springs):
        run(body, 0.2)
        state = pb.getLinkState(body.body, body.sensor_link, physicsClientId=body._client)
        point, force = np.array(state[0]), np.array([20.0, -35.0, 50.0])
        moments = []
        for joint in body._arm:
            axis = pb.getJointInfo(body.body, joint, physicsClientId=body._client)[13]
            link = body.link_pose(joint)
            moments.append(link[:3, :3] @ np.array(axis) @ cross(point - link[:3, 3], force))
        for _ in range(2000):
            pb.applyExternalForce(
                body.body,
                body.sensor_link,
                force.tolist(),
                point.tolist(),
                pb.WORLD_FRAME,
                physicsClientId=body._client,
            )
            run(body, NORMAL.time_step)
        np.testing.assert_allclose(body.arm_state()[0] - HOME, moments / springs.stiffness, rtol=0.01, atol=3e-6)


def test_an_arm_rings_at_the_frequency_of_its_inertia_and_stiffness() -> None:
    with elastic_arm(ROBOTS["mount"], settings=IMPACT) as (body, springs):
        inertia = body.inertia(HOME)[:6, :6]  # the hinge at its stop
        squares, shapes = eigh(np.diag(springs.stiffness), inertia)
        shape = shapes[:, 0] / np.abs(shapes[:, 0]).max()
        omega = float(np.sqrt(squares[0]))
        assert 6.0 < omega / (2 * np.pi) < 25.0, "Hz"
        kick(body, HOME + 2e-4 * shape, np.zeros(6))
        rings = []
        for _ in range(round(5 * 2 * np.pi / omega / IMPACT.time_step)):
            run(body, IMPACT.time_step, IMPACT)
            rings.append(shape @ inertia @ (body.arm_state()[0] - HOME))
        ring = np.array(rings) / rings[0]
        falling = np.flatnonzero((ring[:-1] > 0.0) & (ring[1:] <= 0.0))
        period = float(np.diff(falling).mean()) * IMPACT.time_step
        damping = float(shape @ (springs.damping * shape) / (shape @ inertia @ shape)) / (2 * omega)
        assert 0.02 < damping < 0.1
        assert period == pytest.approx(2 * np.pi / (omega * np.sqrt(1 - damping**2)), rel=0.02)
        turns = [ring[a:b].max() for a, b in pairwise(falling)]
        assert turns[-1] / turns[0] == pytest.approx(np.exp(-2 * np.pi * damping * (len(turns) - 1)), rel=0.15)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("size", [0.1, 1.0, 3.0])
def test_steps_are_stable_in_every_pose(name: str, size: float) -> None:
    """Gains that are laid out at the start; what is left below 4 is the grip's (`GripGains.stable`)."""
    h = NORMAL.time_step
    with elastic_arm(ROBOTS[name], size=size) as (body, springs):
        number = np.diag(h * h * springs.stiffness + 2 * h * springs.damping)
        for q in np.random.default_rng(6).uniform(-np.pi, np.pi, (200, 6)):
            mobility = np.linalg.inv(body.inertia(q))[:6, :6]
            assert np.linalg.eigvals(mobility @ number).real.max() < 3.0
        assert np.all(springs.stiffness <= np.array(STIFFNESS) / size + 1e-6)
        if size >= 1.0:
            np.testing.assert_allclose(springs.stiffness[:5], np.array(STIFFNESS[:5]) / size)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("settings", seldom(NORMAL, IMPACT), ids=["1 ms", "1/4 ms"])
def test_energy_does_not_grow_after_a_kick(name: str, settings: StepSettings) -> None:
    """Without gravity, so that the springs are tensioned at the start; the joints get speeds besides."""
    rng = np.random.default_rng(3)
    for q in POSES:
        with elastic_arm(ROBOTS[name], q, gravity=0.0, settings=settings) as (body, springs):
            kick(body, q, rng.uniform(-0.05, 0.05, 6))
            energies = []
            for _ in range(round(0.3 / settings.time_step)):
                run(body, settings.time_step, settings)
                at, speed = body.arm_state()
                bent = springs.motor - at
                moving = 0.5 * speed @ body.inertia(at)[:6, :6] @ speed
                energies.append(moving + 0.5 * bent @ (springs.stiffness * bent))
            windows = np.max(np.reshape(energies, (6, -1)), axis=1)
            assert np.all(windows[1:] <= 1.02 * windows[:-1]), q
            assert windows[-1] < 0.5 * windows[0], q


def test_joints_that_follow_exactly_have_no_springs() -> None:
    client = pb.connect(pb.DIRECT)
    try:
        robot = ROBOTS["shadow"]
        assert RobotBody(client, robot, HOME, robot.hand_open)._elastic is None
    finally:
        pb.disconnect(client)


def test_an_overloaded_joint_yields_at_its_torque_and_comes_back() -> None:
    with elastic_arm(ROBOTS["mount"]) as (body, springs):
        q, still, largest = springs.motor, [0.0] * 6, np.array(body._arm_effort)
        pushed = (HOME + np.array([0.1, -0.1, 0.1, 0.1, 0.1, -0.1])).tolist()
        torques = np.array(springs.step(HOME.tolist(), still, pushed, still, NORMAL.time_step))
        np.testing.assert_allclose(np.abs(torques), largest)
        assert np.abs(springs.motor - pushed).max() < 0.03
        for _ in range(200):
            springs.step(HOME.tolist(), still, HOME.tolist(), still, NORMAL.time_step)
        np.testing.assert_allclose(springs.motor, q, atol=1e-6)
