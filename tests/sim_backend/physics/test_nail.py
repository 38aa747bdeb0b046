"""The nail against the energy balance: free hammer heads fly at it, without gravity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pybullet as pb
import pytest
from scipy.spatial.transform import Rotation

from tests.errors import raises
from tests.sim_backend.physics.energy_balance import driven_by
from toolee_robot.end_effectors import Category
from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array, inverse, is_rigid, transform
from toolee_robot.sim_backend.physics.bodies import IMPACT, StepSettings, ToolBody
from toolee_robot.sim_backend.physics.nail import HINGE_X, LUMPED_MASS, Nail, NailOutcome
from toolee_robot.sim_backend.physics.wood import (
    NailSpec,
    bend_resistance,
    driving_work,
    embedding_strength,
    resistance,
    tip_force,
)
from toolee_robot.station import sim_station
from toolee_robot.tools import ToolKind, make_tool
from toolee_robot.tools import test_seeds as held_out_seeds

pytestmark = pytest.mark.sim

SPEC = NailSpec.from_config(sim_station().work)
UPRIGHT = np.diag([1.0, -1.0, -1.0])
FACE_RADIUS, HEAD_LENGTH = 0.014, 0.06


@dataclass
class Bench:
    """A nail in a block of wood."""

    client: int
    nail: Nail

    def step(self, settings: StepSettings, duration: float) -> None:
        settings.apply(self.client)
        for _ in range(round(duration / settings.time_step)):
            self.nail.before_step(settings.time_step)
            pb.stepSimulation(physicsClientId=self.client)

    def strike(
        self, mass: float, speed: float, *, offset: float = 0.0, tilt: float = 0.0, settings: StepSettings = IMPACT
    ) -> float:
        """A free head hits the nail; how far it drives it [m]. The head is taken away afterwards."""
        gap = 0.003
        shape = pb.createCollisionShape(
            pb.GEOM_CYLINDER, radius=FACE_RADIUS, height=HEAD_LENGTH, physicsClientId=self.client
        )
        quaternion = pb.getQuaternionFromEuler([0, tilt, 0])
        X = transform(np.reshape(pb.getMatrixFromQuaternion(quaternion), (3, 3)))
        lift = gap + FACE_RADIUS * np.sin(abs(tilt))
        face = self.nail.head_pose()[:3, 3] + [offset, 0.0, lift]
        head = pb.createMultiBody(
            mass, shape, -1, face + X[:3, 2] * HEAD_LENGTH / 2, quaternion, physicsClientId=self.client
        )
        pb.changeDynamics(
            head, -1, linearDamping=0, angularDamping=0, restitution=0, lateralFriction=0.5, physicsClientId=self.client
        )
        pb.resetBaseVelocity(head, [0, 0, -speed], physicsClientId=self.client)
        before = self.nail.protrusion
        self.step(settings, lift / speed + 0.025)
        pb.removeBody(head, physicsClientId=self.client)
        return before - self.nail.protrusion


@pytest.fixture
def bench() -> Iterator[Bench]:
    yield from make_bench(SPEC)


def make_bench(spec: NailSpec, lean: tuple[float, float] = (0.0, 0.0)) -> Iterator[Bench]:
    client = pb.connect(pb.DIRECT)
    shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[0.05, 0.05, 0.03], physicsClientId=client)
    wood = pb.createMultiBody(0.0, shape, -1, [0.0, 0.0, -0.03], physicsClientId=client)
    yield Bench(client, Nail(client, transform(UPRIGHT, [0.0, 0.0, spec.protrusion]), spec, wood, lean=lean))
    pb.disconnect(client)


def fresh_blow(offset: float = 0.0, tilt: float = 0.0) -> float:
    """One strike of 0.6 kg at 1.5 m/s on a new nail [m]."""
    return next(make_bench(SPEC)).strike(0.6, 1.5, offset=offset, tilt=tilt)


def collision_energy(mass: float, speed: float) -> float:
    """Kinetic energy [J] left after the plastic collision of the head with the nail's lumped mass."""
    return 0.5 * mass * speed**2 * mass / (mass + LUMPED_MASS)


@pytest.mark.parametrize("mass", [0.5, 0.8])
@pytest.mark.parametrize("speed", [1.0, 1.5, 2.0, 2.5])
def test_drive_agrees_with_the_energy_balance(bench: Bench, mass: float, speed: float) -> None:
    """0.3 % off at most here, and never with more energy than the head has."""
    driven = bench.strike(mass, speed)
    expected = driven_by(SPEC, SPEC.protrusion, collision_energy(mass, speed))
    assert driven == pytest.approx(expected, rel=0.006)
    assert driving_work(SPEC, SPEC.protrusion, SPEC.protrusion - driven) < 0.5 * mass * speed**2


def test_steps_of_a_millisecond_follow_the_balance_and_the_default_step_fails() -> None:
    expected = driven_by(SPEC, SPEC.protrusion, collision_energy(0.6, 1.5))
    errors = []
    for step in (1 / 240, 1 / 1000, 1 / 4000, 1 / 16000):
        driven = next(make_bench(SPEC)).strike(0.6, 1.5, settings=StepSettings(step, 100, 0.0))
        errors.append(abs(driven / expected - 1))
    assert errors[0] > 0.02
    assert max(errors[1:]) < 0.005


@pytest.mark.parametrize(("mass", "least", "most"), [(0.5, 7, 10), (0.8, 4, 7)])
def test_default_nail_goes_flush_in_a_handful_of_strikes(bench: Bench, mass: float, least: int, most: int) -> None:
    strikes = 0
    while bench.nail.outcome is NailOutcome.STANDING and strikes < 40:
        bench.strike(mass, 1.5)
        strikes += 1
    assert bench.nail.outcome is NailOutcome.FLUSH
    assert least <= strikes <= most


def test_the_head_stops_at_the_wood(bench: Bench) -> None:
    for _ in range(12):
        bench.strike(1.0, 2.0)
    assert -0.0005 < bench.nail.protrusion < 0.0005
    assert bench.nail.outcome is NailOutcome.FLUSH


def test_a_pressing_hammer_does_not_move_a_nail_between_strikes(bench: Bench) -> None:
    """100 N for half a second, in a motion's long steps, with an arm's mass; strikes drive it as before."""
    shape = pb.createCollisionShape(
        pb.GEOM_CYLINDER, radius=FACE_RADIUS, height=HEAD_LENGTH, physicsClientId=bench.client
    )
    hammer = pb.createMultiBody(5.0, shape, -1, [0, 0, SPEC.protrusion + 0.0305], physicsClientId=bench.client)
    StepSettings(1 / 1000, 50, 0.2).apply(bench.client)
    for _ in range(500):
        bench.nail.before_step(1 / 1000, struck=False)
        pb.applyExternalForce(hammer, -1, [5, 0, -100], [0, 0, 0], pb.LINK_FRAME, physicsClientId=bench.client)
        pb.stepSimulation(physicsClientId=bench.client)
    assert bench.nail.protrusion == pytest.approx(SPEC.protrusion, abs=1e-6)
    assert bench.nail.bend_angle < 1e-4
    pb.removeBody(hammer, physicsClientId=bench.client)
    assert bench.strike(0.6, 1.5) == pytest.approx(fresh_blow(), rel=1e-3)


def test_eccentric_strikes_drive_less_and_a_miss_drives_nothing() -> None:
    drives = [fresh_blow(offset=offset) for offset in (0.0, 0.004, 0.008, 0.012)]
    assert drives == sorted(drives, reverse=True)
    assert drives[-1] < 0.9 * drives[0]
    assert fresh_blow(offset=0.020) == pytest.approx(0.0, abs=1e-5)


def test_tilted_strikes_drive_less() -> None:
    drives = [fresh_blow(tilt=np.deg2rad(angle)) for angle in (0.0, 10.0, 20.0, 30.0)]
    assert drives == sorted(drives, reverse=True)
    assert drives[-1] < 0.9 * drives[0]


def push_sideways(bench: Bench, force: float, duration: float) -> None:
    IMPACT.apply(bench.client)
    for _ in range(round(duration / IMPACT.time_step)):
        bench.nail.before_step(IMPACT.time_step)
        at = bench.nail.head_pose()[:3, 3]
        pb.applyExternalForce(bench.nail.body, 2, [force, 0, 0], at, pb.WORLD_FRAME, physicsClientId=bench.client)
        pb.stepSimulation(physicsClientId=bench.client)


def test_side_load_bends_only_beyond_the_plastic_moment(bench: Bench) -> None:
    yield_force = SPEC.plastic_moment / SPEC.protrusion
    push_sideways(bench, 0.8 * yield_force, 0.02)
    assert bench.nail.bend_angle < np.deg2rad(0.5)
    push_sideways(bench, 1.5 * yield_force, 0.02)
    bench.step(IMPACT, 0.05)
    bent = bench.nail.bend_angle
    assert bent > np.deg2rad(10.0)
    assert bench.nail.outcome is NailOutcome.BENT
    bench.step(IMPACT, 0.05)
    assert bench.nail.bend_angle == pytest.approx(bent, abs=1e-3)
    head = bench.nail.head_pose()
    assert is_rigid(head)
    assert head[0, 3] == pytest.approx(SPEC.protrusion * np.sin(bent), rel=0.1)


def bend(bench: Bench, angle: float) -> None:
    pb.resetJointState(bench.nail.body, HINGE_X, np.deg2rad(angle), physicsClientId=bench.client)


def test_a_nail_bent_in_its_hole_is_driven_less(bench: Bench) -> None:
    bend(bench, 5.0)
    driven = bench.strike(0.6, 1.5)
    straight = fresh_blow()
    assert 0.2 * straight < driven < 0.6 * straight
    assert driving_work(SPEC, SPEC.protrusion, SPEC.protrusion - driven, np.deg2rad(5.0)) < 0.5 * 0.6 * 1.5**2


def test_a_head_pushed_three_millimetres_aside_is_bent_however_deep_it_is_driven(bench: Bench) -> None:
    outcomes = []
    for angle in (8.0, 9.0):
        bend(bench, angle)
        bench.step(IMPACT, IMPACT.time_step)
        outcomes.append(bench.nail.outcome)
    assert outcomes == [NailOutcome.STANDING, NailOutcome.BENT]
    pb.resetJointState(bench.nail.body, 2, SPEC.protrusion - 0.0005, physicsClientId=bench.client)
    bench.step(IMPACT, IMPACT.time_step)
    assert bench.nail.shift < 1e-3
    assert bench.nail.largest_shift == pytest.approx(SPEC.protrusion * np.sin(np.deg2rad(9.0)), rel=0.01)
    assert bench.nail.outcome is NailOutcome.BENT


def test_a_leaning_nail_is_driven_along_its_hole_and_from_ten_degrees_on_is_bent() -> None:
    lean = np.deg2rad([2.0, -3.0])
    bench = next(make_bench(SPEC, (float(lean[0]), float(lean[1]))))
    nail = bench.nail
    assert np.rad2deg(nail.lean_angle) == pytest.approx(np.hypot(2.0, 3.0), abs=0.01)
    assert nail.bend_angle == pytest.approx(0.0, abs=1e-9)
    tip = nail.head_pose() @ [0.0, 0.0, SPEC.protrusion, 1.0]
    np.testing.assert_allclose(tip[:3], np.zeros(3), atol=1e-9)
    for _ in range(15):
        bench.strike(0.8, 1.5)
    assert nail.outcome is NailOutcome.FLUSH
    assert nail.lean_angle < np.deg2rad(8.0)
    assert next(make_bench(SPEC, (np.deg2rad(10.1), 0.0))).nail.outcome is NailOutcome.BENT


def test_the_walls_of_a_bent_nails_hole_hold_its_plastic_moment() -> None:
    """Against the beam equations: pressure of 0.082 (1 - 0.01 d) rho [N/mm2] on b and -b, and M / b to bend."""
    f = 0.082 * (1 - 0.01 * 2.2) * 350.0
    assert embedding_strength(SPEC) == pytest.approx(f * 1e6)
    b = np.sqrt(SPEC.plastic_moment * 1e3 / (f * 2.2))  # [mm]
    steep = bend_resistance(SPEC, np.deg2rad(9.0)) - bend_resistance(SPEC, np.deg2rad(8.0))
    assert steep == pytest.approx(2 * SPEC.plastic_moment * 1e3 / b * np.deg2rad(1.0))
    small = [bend_resistance(SPEC, np.deg2rad(angle)) for angle in (0.0, 0.3, 0.6)]
    assert small == pytest.approx([0.0, small[1], 2 * small[1]])
    assert bend_resistance(SPEC, np.deg2rad(10.0)) > 1.5 * resistance(SPEC, SPEC.protrusion)


def test_reported_head_pose_is_the_bodys(bench: Bench) -> None:
    """head_pose composes the joints; pybullet's own link pose must agree, bent and driven."""
    bench.strike(0.8, 2.0)
    push_sideways(bench, 1.6 * SPEC.plastic_moment / bench.nail.protrusion, 0.01)
    pose = pb.getLinkState(bench.nail.body, 2, computeForwardKinematics=True, physicsClientId=bench.client)
    R = np.reshape(pb.getMatrixFromQuaternion(pose[5]), (3, 3))
    in_link: Array = np.array([0.0, 0.0, -SPEC.protrusion])
    expected = transform(R, np.asarray(pose[4]) + R @ in_link)
    np.testing.assert_allclose(bench.nail.head_pose(), expected, atol=1e-5)


@pytest.mark.parametrize("seed", held_out_seeds(3))
@pytest.mark.parametrize("kind", [ToolKind.CLAW_HAMMER, ToolKind.BALL_PEEN_HAMMER, ToolKind.CLUB_HAMMER])
def test_a_hammers_face_meets_the_head_where_it_is(bench: Bench, kind: ToolKind, seed: int) -> None:
    hammer = make_tool(kind, seed)
    X_tool_ee = hammer.ee(Category.HAMMER_HEAD).X_tool_ee
    body = ToolBody(bench.client, hammer, np.eye(4))
    for spin in (0.0, 0.4, 1.9):
        X_nail_ee = transform(Rotation.from_rotvec([0.0, 0.0, spin]), [0.0, 0.0, -0.004])
        body.place(bench.nail.head_pose() @ X_nail_ee @ inverse(X_tool_ee))
        points = pb.getClosestPoints(body.body, bench.nail.body, 0.05, linkIndexB=2, physicsClientId=bench.client)
        assert min(p[8] for p in points) == pytest.approx(0.004, abs=5e-5)


def test_impact_window_opens_near_the_head_only(bench: Bench) -> None:
    shape = pb.createCollisionShape(pb.GEOM_SPHERE, radius=0.01, physicsClientId=bench.client)
    ball = pb.createMultiBody(1.0, shape, -1, [0, 0, 0.1], physicsClientId=bench.client)
    assert not bench.nail.impact_near(ball)
    pb.resetBasePositionAndOrientation(ball, [0, 0, 0.034], [0, 0, 0, 1], physicsClientId=bench.client)
    assert bench.nail.impact_near(ball)


def test_resistance_has_the_size_of_the_reference_law() -> None:
    """F = 150 N (d/3)^2 + 1.6 MPa pi d depth, the plausible law for pine without a hole, d in mm."""
    for diameter, depth in ((0.0025, 0.010), (0.003, 0.030), (0.003, 0.060)):
        spec = NailSpec(
            diameter=diameter, length=depth + 0.020, pilot_diameter=0.0, head_diameter=0.008, specific_gravity=0.42
        )
        reference = 150 * (diameter / 0.003) ** 2 + 1.6e6 * np.pi * diameter * depth
        assert resistance(spec, 0.020) == pytest.approx(reference, rel=0.25)


def test_denser_wood_resists_more_and_a_pilot_hole_less() -> None:
    pine = resistance(NailSpec(pilot_diameter=0.0, specific_gravity=0.42), 0.01)
    oak = resistance(NailSpec(pilot_diameter=0.0, specific_gravity=0.68), 0.01)
    assert oak / pine == pytest.approx((0.68 / 0.42) ** 2.5)
    assert tip_force(NailSpec(pilot_diameter=0.0011)) == pytest.approx(0.75 * tip_force(NailSpec(pilot_diameter=0.0)))
    assert resistance(NailSpec(pilot_diameter=0.0015), 0.01) < pine


@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        ({"diameter": 2.5}, "config.nail_diameter"),
        ({"protrusion": 0.05}, "config.nail_protrusion"),
        ({"pilot_diameter": 0.003}, "config.pilot_hole"),
        ({"specific_gravity": 420.0}, "config.specific_gravity"),
        ({"head_diameter": 0.002}, "config.nail_head"),
    ],
)
def test_impossible_nails_are_refused(wrong: dict[str, float], code: str) -> None:
    with raises(ConfigError, code=code):
        NailSpec(**wrong)
