"""The judge against a small world whose truth is known: a free hammer head thrown at a nail."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import numpy as np
import pybullet as pb
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import TooleeError
from toolee_robot.frames import Array, cross, inverse, transform
from toolee_robot.sim_backend.judge import Judge
from toolee_robot.sim_backend.physics.bodies import IMPACT
from toolee_robot.sim_backend.physics.nail import Nail, NailOutcome
from toolee_robot.sim_backend.physics.wood import NailSpec, driving_work
from toolee_robot.sim_backend.truth import StruckBy, pose_error, strike_offset, strike_tilt
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.types import InHandEstimate

pytestmark = pytest.mark.sim

DOWN = np.diag([1.0, -1.0, -1.0])
SPEC = NailSpec()
HALF = 0.03  # [m] half the head's length
angles = st.floats(-3.0, 3.0)
lengths = st.floats(-0.2, 0.2)


class ThrownHead:
    """A hammer head without gravity, in a hand that is only a frame moving with it."""

    def __init__(self, client: int, X_hand_ee: Array) -> None:
        self.client, self.time = client, 0.0
        self.nail = Nail(client, transform(DOWN, [0.0, 0.0, SPEC.protrusion]), SPEC)
        self.nails = {"nail": self.nail}
        shape = pb.createCollisionShape(pb.GEOM_CYLINDER, radius=0.014, height=2 * HALF, physicsClientId=client)
        self.tool_body = int(pb.createMultiBody(0.6, shape, -1, [0, 0, 0.3], physicsClientId=client))
        pb.changeDynamics(self.tool_body, -1, linearDamping=0, angularDamping=0, restitution=0, physicsClientId=client)
        self.X_hand_ee = X_hand_ee
        self.X_tool_ee = transform(DOWN, [0.0, 0.0, -HALF])
        self.robot_body = int(pb.createMultiBody(0.0, shape, -1, [9, 9, 9], physicsClientId=client))
        self.judge = Judge(cast(SimWorld, self))

    def X_base_ee(self) -> Array:
        p, q = pb.getBasePositionAndOrientation(self.tool_body, physicsClientId=self.client)
        return transform(Rotation.from_quat(q), p) @ self.X_tool_ee

    @property
    def tool(self) -> ThrownHead:
        return self

    def face(self) -> Array:
        return np.asarray(self.X_base_ee()[:3, 3])

    def face_velocity(self) -> Array:
        v, w = pb.getBaseVelocity(self.tool_body, physicsClientId=self.client)
        return v + cross(w, self.face() - pb.getBasePositionAndOrientation(self.tool_body, self.client)[0])

    def X_base_hand(self) -> Array:
        return self.X_base_ee() @ inverse(self.X_hand_ee)

    def throw(self, *, speed: float, offset: float = 0.0, tilt: float = 0.0, duration: float = 0.05) -> None:
        """Put the face's centre 12 mm over the nail's head and let it go down."""
        q = Rotation.from_rotvec([0.0, tilt, 0.0])
        face = self.nail.head_pose()[:3, 3] + [offset, 0.0, 0.012]
        com = face + q.apply([0.0, 0.0, HALF])
        pb.resetBasePositionAndOrientation(self.tool_body, com, q.as_quat(), physicsClientId=self.client)
        pb.resetBaseVelocity(self.tool_body, [0, 0, -speed], [0, 0, 0], physicsClientId=self.client)
        self.run(duration)

    def run(self, duration: float) -> None:
        IMPACT.apply(self.client)
        for _ in range(round(duration / IMPACT.time_step)):
            self.nail.before_step(IMPACT.time_step)
            pb.stepSimulation(physicsClientId=self.client)
            self.time += IMPACT.time_step
            self.judge.after_step()


@pytest.fixture
def world() -> Iterator[ThrownHead]:
    client = pb.connect(pb.DIRECT)
    yield ThrownHead(client, transform(Rotation.from_rotvec([0.2, 1.0, -0.3]), [0.05, 0.02, 0.11]))
    pb.disconnect(client)


def estimate(X_hand_ee: Array, usable: bool = True) -> InHandEstimate:
    return InHandEstimate(Category.HAMMER_HEAD, X_hand_ee, np.eye(6) * 1e-6, 0.9, 5, 5, usable, "ok")


def test_a_strike_is_measured_at_first_contact(world: ThrownHead) -> None:
    world.throw(speed=1.5, offset=0.005, tilt=np.deg2rad(6.0))
    (strike,) = world.judge.strikes
    assert strike.hit
    assert strike.offset_mm == pytest.approx(5.0, abs=0.3)
    assert strike.tilt_deg == pytest.approx(6.0, abs=0.3)
    assert strike.speed == pytest.approx(1.5, rel=0.01)
    assert strike.energy == pytest.approx(0.5 * 0.6 * 1.5**2, rel=0.02)
    assert strike.protrusion_before_mm == pytest.approx(20.0, abs=0.01)
    assert strike.protrusion_mm == pytest.approx(world.nail.protrusion * 1e3)
    assert 0.7 * strike.energy < strike.work < strike.energy
    assert strike.work == pytest.approx(driving_work(SPEC, SPEC.protrusion, world.nail.protrusion), rel=1e-3)
    assert strike.peak_force > 100.0


def test_every_strike_is_counted_once_and_the_first_numbers_stay(world: ThrownHead) -> None:
    for _ in range(3):
        world.throw(speed=1.5)
    first, second, third = world.judge.strikes
    assert first.protrusion_mm == pytest.approx(second.protrusion_before_mm, abs=1e-6)
    assert first.protrusion_mm > second.protrusion_mm > third.protrusion_mm
    assert world.judge.verdict().hits == 3


def test_touching_slowly_is_no_strike(world: ThrownHead) -> None:
    world.throw(speed=0.03, duration=0.5)
    assert world.judge.strikes == ()


def test_a_miss_is_a_strike_that_hit_nothing(world: ThrownHead) -> None:
    world.throw(speed=1.5, offset=0.025)
    (miss,) = world.judge.strikes
    assert not miss.hit
    assert miss.offset_mm == pytest.approx(25.0, abs=0.1)
    assert miss.protrusion_mm == pytest.approx(20.0)
    verdict = world.judge.verdict()
    assert (verdict.hits, verdict.off_face_strikes, verdict.misses) == (0, 0, 1)
    assert verdict.strike_offset_mm == pytest.approx(25.0, abs=0.1)


@pytest.mark.parametrize("tilt", [0.0, 8.0, 20.0])
@pytest.mark.parametrize("offset", [0.0, 0.006, 0.011])
def test_the_faces_rim_is_face(world: ThrownHead, offset: float, tilt: float) -> None:
    world.throw(speed=1.5, offset=offset, tilt=np.deg2rad(tilt))
    assert [strike.struck_by for strike in world.judge.strikes] == [StruckBy.FACE]


def test_a_cheek_that_drives_the_nail_does_not_count(world: ThrownHead) -> None:
    """The head flies down on its side: what meets the nail is the cylinder's flank, and the face looks aside."""
    world.X_tool_ee = transform(Rotation.from_rotvec([0.0, np.pi / 2, 0.0]), [0.014, 0.0, -HALF + 0.02])
    world.throw(speed=1.5)
    (strike,) = world.judge.strikes
    assert strike.struck_by is StruckBy.OTHER_PART
    assert not strike.hit
    assert strike.protrusion_mm < strike.protrusion_before_mm - 1.0, "it drove the nail all the same"
    verdict = world.judge.verdict()
    assert (verdict.hits, verdict.off_face_strikes, verdict.misses) == (0, 1, 0)


@pytest.mark.parametrize("cheek", [False, True])
def test_a_nail_that_a_cheek_has_driven_is_not_flush(world: ThrownHead, cheek: bool) -> None:
    if cheek:
        world.X_tool_ee = transform(Rotation.from_rotvec([0.0, np.pi / 2, 0.0]), [0.014, 0.0, -HALF + 0.02])
    for _ in range(40):
        if world.nail.outcome is NailOutcome.FLUSH:
            break
        world.throw(speed=2.0)
    assert world.nail.outcome is NailOutcome.FLUSH
    (nail,) = world.judge.verdict().nails
    assert nail.outcome == ("not_by_face" if cheek else "flush")


def test_a_hand_on_the_nail_does_not_count(world: ThrownHead) -> None:
    """A fist beside the face meets the nail, and the face passes it."""
    shape = pb.createCollisionShape(pb.GEOM_SPHERE, radius=0.02, physicsClientId=world.client)
    world.robot_body = int(pb.createMultiBody(0.6, shape, -1, [0, 0, 0.2], physicsClientId=world.client))
    fist = world.nail.head_pose()[:3, 3] + [0.0, 0.0, 0.022]
    pb.resetBasePositionAndOrientation(world.robot_body, fist, [0, 0, 0, 1], physicsClientId=world.client)
    pb.resetBaseVelocity(world.robot_body, [0, 0, -1.5], physicsClientId=world.client)
    world.throw(speed=1.5, offset=0.05)
    assert [strike.struck_by for strike in world.judge.strikes] == [StruckBy.HAND]


def test_in_hand_pose_is_known_at_every_time_of_the_run(world: ThrownHead) -> None:
    world.throw(speed=1.5, offset=0.012)
    slipped = transform(Rotation.from_rotvec([0.0, 0.0, 0.1]), [0.01, 0.0, 0.0]) @ world.X_hand_ee
    before, world.X_hand_ee = world.X_hand_ee, slipped
    half_time = world.time
    world.run(0.05)
    np.testing.assert_allclose(world.judge.X_hand_ee(half_time / 2), before, atol=1e-9)
    np.testing.assert_allclose(world.judge.X_hand_ee(world.time - 0.01), slipped, atol=1e-9)
    with raises(TooleeError, code="toolee.outside_of_run"):
        world.judge.X_hand_ee(world.time + 1.0)


def test_estimate_error_is_that_of_face_and_normal_and_free_of_spin(world: ThrownHead) -> None:
    world.throw(speed=1.5)
    off = transform(Rotation.from_rotvec([np.deg2rad(2.0), 0.0, 0.0]), [0.003, 0.0, 0.004])
    spun = world.X_hand_ee @ off @ transform(Rotation.from_rotvec([0.0, 0.0, 1.3]))
    error = world.judge.estimate_error(0.01, estimate(spun))
    assert error.position_mm == pytest.approx(5.0)
    assert error.angle_deg == pytest.approx(2.0)


def test_verdict_judges_the_last_usable_estimate_before_the_first_strike(world: ThrownHead) -> None:
    assert world.judge.verdict().pose_error_mm is None
    world.throw(speed=1.5)
    late = world.time
    estimates = [
        (0.0, estimate(world.X_hand_ee @ transform(p=[0.009, 0, 0]))),
        (0.001, estimate(world.X_hand_ee @ transform(p=[0.002, 0, 0]))),
        (0.002, estimate(world.X_hand_ee @ transform(p=[0.050, 0, 0]), usable=False)),
        (0.003, estimate(np.full((4, 4), np.nan), usable=False)),
        (late, estimate(world.X_hand_ee)),
    ]
    verdict = world.judge.verdict(estimates)
    assert verdict.pose_error_mm == pytest.approx(2.0)
    assert verdict.worst().outcome == "standing"


@given(angles, angles, angles, lengths, lengths, lengths)
def test_offset_and_tilt_do_not_depend_on_spin_or_depth(
    a: float, b: float, spin: float, x: float, y: float, z: float
) -> None:
    X_base_nail = transform(Rotation.from_rotvec([a, b, 0.3]), [0.7, 0.1, 0.2])
    tilt = 0.1
    X_nail_ee = transform(Rotation.from_rotvec([tilt, 0, 0]) * Rotation.from_rotvec([0, 0, spin]), [x, y, z])
    assert strike_offset(X_base_nail, X_base_nail @ X_nail_ee) == pytest.approx(np.hypot(x, y), abs=1e-9)
    assert strike_tilt(X_base_nail, X_base_nail @ X_nail_ee) == pytest.approx(tilt, abs=1e-9)


@given(spin=angles)
def test_pose_error_follows_the_category(spin: float) -> None:
    X = transform(Rotation.from_rotvec([0.4, -0.2, 0.9]), [0.1, 0.2, 0.3])
    spun = X @ transform(Rotation.from_rotvec([0, 0, spin]))
    assert pose_error(spun, X, Category.HAMMER_HEAD).angle_deg == pytest.approx(0.0, abs=1e-4)
    assert pose_error(spun, X, Category.HAMMER_GRIP).angle_deg == pytest.approx(np.rad2deg(abs(spin)), abs=1e-4)
