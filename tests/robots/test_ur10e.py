"""Both arms, nominal and calibrated: the URDF's kinematics are those of their Denavit-Hartenberg parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from tests.examples import examples, seldom
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover
from toolee_robot.control.kinematics import smallest_singular_value
from toolee_robot.control.motion.trajectory_checks import START_TOLERANCE
from toolee_robot.control.planning.straight import Line
from toolee_robot.errors import AssetError, ConfigError, UnreachableError
from toolee_robot.frames import HALF_TURN, Array, inverse, transform
from toolee_robot.robots import FLANGE_FRAME, SHADOW_HAND, load_robot
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.station import load_station, sim_station
from toolee_robot.types import ArmModel, DhCalibration

MODELS = list(ArmModel)
Q_HAND = SHADOW_HAND.posture("open")
# Universal Robots' tables, typed in a second time: d1, a2, a3, d4, d5, d6 [m].
TABLE = {
    ArmModel.UR10: (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    ArmModel.UR10E: (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
}
ANGLES = st.lists(st.floats(-6.2, 6.2), min_size=6, max_size=6).map(np.array)


def _chain(model: ArmModel, q: Array) -> Array:
    """The flange in the controller's base, from the table."""
    d1, a2, a3, d4, d5, d6 = TABLE[model]
    alpha = np.array([1, 0, 0, 1, -1, 0]) * np.pi / 2
    X = np.eye(4)
    for angle, d, a, twist in zip(q, (d1, 0, 0, d4, d5, d6), (0, a2, a3, 0, 0, 0), alpha, strict=True):
        X = X @ transform(Rotation.from_euler("z", angle), [0, 0, d])
        X = X @ transform(Rotation.from_euler("x", twist), [a, 0, 0])
    return X


def _measured(model: ArmModel, seed: int) -> tuple[DhCalibration, list[Array]]:
    """A factory calibration of an arm whose six axes are a millimetre and a milliradian off (standard deviations)."""
    rng = np.random.default_rng(seed)
    nominal = DhParameters.of(model)
    axes = [
        X @ transform(Rotation.from_rotvec([*rng.normal(0, 1e-3, 2), 0.0]), rng.normal(0, 1e-3, 3))
        for X in nominal.zero_frames()[:6]
    ]
    axes[0] = np.eye(4)  # the base is where the first axis is
    X = np.eye(4)
    theta, d, a, alpha = np.zeros(6), nominal.d.copy(), nominal.a.copy(), nominal.alpha.copy()
    for i in range(5):
        p, z, p_next, z_next = X[:3, 3], X[:3, 2], axes[i + 1][:3, 3], axes[i + 1][:3, 2]
        normal = np.cross(z, z_next)
        # Feet of the common normal: p + d z and p_next + e z_next.
        d[i], _, along = np.linalg.solve(np.column_stack([z, -z_next, normal]), p_next - p)
        x = normal / np.linalg.norm(normal)
        a[i] = along * np.linalg.norm(normal)
        if nominal.a[i] * a[i] < 0 or (nominal.a[i] == 0 and np.cross(z, z_next) @ x * nominal.alpha[i] < 0):
            x, a[i] = -x, -a[i]
        theta[i] = np.arctan2(x @ X[:3, 1], x @ X[:3, 0])
        alpha[i] = np.arctan2(np.cross(z, z_next) @ x, z @ z_next)
        X = X @ DhParameters(d, a, alpha, theta).joint(i)
    delta = [
        tuple(float(v) for v in values)
        for values in (theta, a - nominal.a, d - nominal.d, alpha - nominal.alpha)
    ]  # fmt: skip
    return DhCalibration(*delta), axes  # type: ignore[arg-type]


@pytest.mark.parametrize("model", MODELS)
@given(q=ANGLES)
@examples(30)
def test_the_flange_is_where_the_table_has_it(model: ArmModel, q: Array) -> None:
    expected = HALF_TURN @ _chain(model, q)
    np.testing.assert_allclose(load_robot(model).link_poses(q, Q_HAND)[FLANGE_FRAME], expected, atol=1e-9)
    np.testing.assert_allclose(RobotModel.load(model).arm.fk(q), expected, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
@given(q=ANGLES, seed=st.integers(0, 3))
@examples(30)
def test_a_calibrated_arm_turns_about_its_measured_axes(model: ArmModel, q: Array, seed: int) -> None:
    calibration, axes = _measured(model, seed)
    robot = load_robot(model, calibration)
    assert robot.calibrated
    assert not load_robot(model).calibrated
    # The product of exponentials: every joint turns what it carries about its axis of q = 0.
    X = np.eye(4)
    for axis, angle in zip(axes, q, strict=True):
        X = X @ axis @ transform(Rotation.from_euler("z", angle)) @ inverse(axis)
    X = HALF_TURN @ X @ HALF_TURN @ robot.link_poses(np.zeros(6), Q_HAND)[FLANGE_FRAME]
    np.testing.assert_allclose(robot.link_poses(q, Q_HAND)[FLANGE_FRAME], X, atol=1e-7)


@pytest.mark.parametrize("model", MODELS)
def test_a_calibration_moves_frames_by_metres_but_no_link(model: ArmModel) -> None:
    calibration, _ = _measured(model, 0)
    assert np.abs(calibration.delta_d).max() > 1.0
    nominal, own = (load_robot(model, c).link_poses(np.zeros(6), Q_HAND) for c in (None, calibration))
    for name, X in nominal.items():
        off = inverse(X) @ own[name]
        assert np.linalg.norm(off[:3, 3]) < 0.02, name
        assert np.abs(off[:3, :3] - np.eye(3)).max() < 0.02, name
    assert np.linalg.norm(own[FLANGE_FRAME][:3, 3] - nominal[FLANGE_FRAME][:3, 3]) > 1e-4


def _off_by(size: float, seed: int) -> DhCalibration:
    theta, a, d, alpha = (tuple(size * z) for z in np.random.default_rng(seed).normal(size=(4, 6)))
    return DhCalibration(theta, a, d, alpha)


@pytest.mark.parametrize("calibration", ["none", "measured", "some 20 mm off"])
@pytest.mark.parametrize("model", MODELS)
def test_every_pose_is_found_again(model: ArmModel, calibration: str) -> None:
    of = {"none": None, "measured": _measured(model, 1)[0], "some 20 mm off": _off_by(0.004, 12)}
    robot = RobotModel.load(model, of[calibration])
    rng = np.random.default_rng(3)
    q = rng.uniform(-np.pi, np.pi, (300, 6))
    X, J = robot.arm.fk_jacobian(q)
    # The further from the closed form, the wider the neighbourhood of a singularity where a branch is not found.
    regular = smallest_singular_value(J) > (0.15 if calibration == "some 20 mm off" else 0.05)
    assert regular.sum() > 90
    for wanted, pose in zip(q[regular], X[regular], strict=True):
        np.testing.assert_allclose(robot.ik.solve(pose, near=wanted)[0], wanted, atol=1e-6)


@pytest.mark.parametrize(
    "wrong", [DhCalibration((0.0,) * 6, (0.0,) * 6, (0.0,) * 6, (0.0, 0.3, 0.0, 0.0, 0.0, 0.0)), _off_by(0.05, 0)]
)
def test_an_arm_that_is_no_ur_arm_is_refused(wrong: DhCalibration) -> None:
    with raises(AssetError, code="asset.kinematics"):
        RobotModel.load(ArmModel.UR10, wrong)


@pytest.mark.parametrize("model", seldom(*MODELS))
def test_a_calibrated_arm_s_line_starts_where_the_arm_is(model: ArmModel) -> None:
    """Near a singularity, too, where few Newton steps are not enough; an arm refuses to start elsewhere."""
    ik, near = RobotModel.load(model, _measured(model, 1)[0]).ik, 0
    rng = np.random.default_rng(0)
    for _ in range(300):
        q = rng.uniform(-3, 3, 6)
        q[rng.choice([2, 4])] = rng.choice([-1, 1]) * rng.uniform(0.01, 0.1)
        try:
            line = Line.through(ik, q, np.array([0.0, 0.0, 1.0]))
        except UnreachableError:  # of the singularity's own neighbourhood: it is elsewhere for the closed form
            continue
        near += 1
        np.testing.assert_allclose(line.q(np.zeros(1))[0], q, atol=START_TOLERANCE)
        s = np.linspace(0.0, 0.05, 11)
        try:
            X, _ = ik.arm.fk_jacobian(line.q(s))
        except UnreachableError:  # further on: said, not driven beside the line
            continue
        np.testing.assert_allclose(X[:, :3, 3], line.X_base_flange[:3, 3] + s[:, None] * line.direction, atol=1e-8)
    assert near > 180


def test_the_station_says_which_arm_it_is(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    six = [0.0, 1e-4, 0.0, 0.0, 0.0, 0.0]
    rows = "".join(f"    delta_{name}: {six}\n" for name in ("theta", "a", "d", "alpha"))
    path.write_text(f"arm:\n  model: UR10e\n  calibration:\n{rows}")
    arm = load_station(path).arm
    assert arm.model is ArmModel.UR10E
    assert arm.calibration is not None
    assert load_robot(arm.model, arm.calibration).calibrated
    for wrong in ("arm: {model: UR16}", f"arm: {{calibration: {{delta_theta: {six}}}}}"):
        path.write_text(wrong)
        with pytest.raises(ConfigError, match="arm"):
            load_station(path)


def test_a_ur10e_reaches_the_handover_from_home() -> None:
    config = replace(sim_station(), arm=replace(sim_station().arm, model=ArmModel.UR10E))
    robot = RobotModel.load(ArmModel.UR10E)
    q_hand = robot.description.hand_open
    home = np.array(sim_station().scene.home)
    trajectory = plan_handover(robot, config, CollisionWorld(robot, config, q_hand), home, q_hand)
    X_base_hand = robot.fk(trajectory.q[-1], q_hand)[1]
    np.testing.assert_allclose(X_base_hand[:3, 3], config.scene.handover_position, atol=1e-3)
