"""Pooling of candidates modulo a symmetry group, and the spin fix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.examples import examples
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose.cloud_estimator import PoseResult, with_hand
from toolee_robot.perception.pose.pooling import (
    FREE_SPIN_VARIANCE,
    align,
    fix_spin,
    pairwise_angles,
    pool,
)
from toolee_robot.perception.pose.representation import rotation_matrix, rotation_vectors, rotations_about, twist_angles
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind
from toolee_robot.tools import ToolKind, make_tool, train_seeds
from toolee_robot.types import HoldingHand, PoseHypotheses

seeds = st.integers(0, 2**31)
GROUPS = [
    SymmetryGroup(SymmetryKind.NONE),
    SymmetryGroup(SymmetryKind.C2, (1.0, 0.0, 0.0)),
    SymmetryGroup(SymmetryKind.CINF, (0.0, 0.0, 1.0)),
]


def candidates(rng: np.random.Generator, X: Array, n: int = 32, angle: float = 0.05, distance: float = 0.002) -> Array:
    noise = [transform(Rotation.from_rotvec(rng.normal(0, angle, 3)), rng.normal(0, distance, 3)) for _ in range(n)]
    return np.stack([transform(X[:3, :3] @ N[:3, :3], X[:3, 3] + N[:3, 3]) for N in noise])


def random_pose(rng: np.random.Generator) -> Array:
    return transform(Rotation.random(rng=rng), rng.normal(0, 0.3, 3))


def random_element(rng: np.random.Generator, group: SymmetryGroup) -> Array:
    elements = group.elements(360)
    return np.asarray(elements[rng.integers(len(elements))])


@given(seeds)
@examples(30)
def test_the_closed_forms_of_rotations_are_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(8, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    w = axes * np.array([0.0, 1e-12, 1e-7, 1e-3, 0.1, 1.0, 2.0, 2.8])[:, None]
    R = Rotation.from_rotvec(w).as_matrix()
    np.testing.assert_allclose([rotation_matrix(v) for v in w], R, atol=1e-15)
    np.testing.assert_allclose(rotation_vectors(R), w, atol=1e-14)
    angles = rng.uniform(-np.pi, np.pi, 8)
    about = Rotation.from_rotvec(angles[:, None] * axes[0]).as_matrix()
    np.testing.assert_allclose(rotations_about(axes[0], angles), about, atol=1e-15)
    # A swing, whose axis is at right angles to the twist's, takes nothing from the twist.
    swing = Rotation.from_rotvec(np.cross(axes[0], axes)).as_matrix()
    np.testing.assert_allclose(twist_angles(swing @ about, axes[0]), angles, atol=1e-13)


@pytest.mark.parametrize("group", GROUPS, ids=lambda g: g.kind.value)
@given(seed=seeds)
@examples(15)
def test_pooling_does_not_care_which_member_of_an_orbit_a_candidate_is(group: SymmetryGroup, seed: int) -> None:
    rng = np.random.default_rng(seed)
    Xs = candidates(rng, random_pose(rng))
    moved = Xs.copy()
    for i in range(len(Xs)):
        moved[i, :3, :3] = Xs[i, :3, :3] @ random_element(rng, group)
    a, b = pool(Xs, group), pool(moved, group)
    np.testing.assert_allclose(a.X[:3, 3], b.X[:3, 3], atol=2e-4)
    assert group.rotation_error(a.X[:3, :3], b.X[:3, :3]) < 0.01
    assert a.modes == b.modes


@pytest.mark.parametrize("group", GROUPS, ids=lambda g: g.kind.value)
@given(seed=seeds)
@examples(15)
def test_batched_group_functions_agree_with_the_group(group: SymmetryGroup, seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = Rotation.random(4, rng=rng).as_matrix()
    angles = pairwise_angles(R, group)
    np.testing.assert_allclose(angles, angles.T, atol=1e-7)
    for i in range(4):
        assert angles[0, i] == pytest.approx(group.rotation_error(R[0], R[i]), abs=1e-6)
        aligned = align(R[i][None], R[0], group)[0]
        assert group.rotation_error(aligned, R[i]) == pytest.approx(0, abs=1e-6)
        expected = group.canonical(R[i], R[0])
        distance = np.linalg.norm(aligned - R[0]) - np.linalg.norm(expected - R[0])
        assert distance == pytest.approx(0, abs=1e-6)


def test_half_of_the_candidates_flipped_still_gives_the_pose() -> None:
    rng = np.random.default_rng(1)
    group = Category.WRENCH_HEAD.symmetry
    X = random_pose(rng)
    Xs = candidates(rng, X, 40)
    Xs[::2, :3, :3] = Xs[::2, :3, :3] @ group.elements()[1]
    pooled = pool(Xs, group)
    assert group.rotation_error(pooled.X[:3, :3], X[:3, :3]) < np.deg2rad(1.5)
    assert pooled.modes == (1.0,)
    # Without the symmetry the same candidates are two modes, and the result is one of them, not their mean.
    unaware = pool(Xs, GROUPS[0])
    assert len(unaware.modes) == 2
    assert group.rotation_error(unaware.X[:3, :3], X[:3, :3]) < np.deg2rad(2.5)


def test_outliers_do_not_move_the_result() -> None:
    rng = np.random.default_rng(2)
    X = random_pose(rng)
    Xs = np.concatenate([candidates(rng, X, 24), np.stack([random_pose(rng) for _ in range(8)])])
    pooled = pool(Xs, GROUPS[0])
    assert np.linalg.norm(pooled.X[:3, 3] - X[:3, 3]) < 0.002
    assert pooled.modes[0] == pytest.approx(0.75, abs=0.04)


def test_covariance_of_a_free_spin() -> None:
    rng = np.random.default_rng(3)
    group = Category.HAMMER_HEAD.symmetry
    X = random_pose(rng)
    Xs = candidates(rng, X, 64, angle=0.02)
    for i, R_i in enumerate(Xs[:, :3, :3]):
        Xs[i, :3, :3] = R_i @ random_element(rng, group)
    pooled = pool(Xs, group, 0.001, 0.02, 0.1, spin_observable=0.0)
    z = pooled.X[:3, 2]
    rotation = pooled.covariance[3:, 3:]
    assert z @ rotation @ z == pytest.approx(FREE_SPIN_VARIANCE, rel=1e-6)
    across = np.cross(z, [0.0, 0.6, 0.8])
    across /= np.linalg.norm(across)
    assert across @ rotation @ across < np.deg2rad(3) ** 2
    assert np.linalg.eigvalsh(pooled.covariance).min() > 0


def test_an_observed_spin_is_kept_and_its_variance_small() -> None:
    rng = np.random.default_rng(4)
    X = random_pose(rng)
    pooled = pool(candidates(rng, X, 64, angle=0.03), Category.HAMMER_HEAD.symmetry, 0.001, 0.03, 0.05, 1.0)
    assert pooled.spin_variance < np.deg2rad(6) ** 2
    assert GROUPS[0].rotation_error(pooled.X[:3, :3], X[:3, :3]) < np.deg2rad(2)


@given(seeds)
@examples(40)
def test_the_fix_replaces_the_twist_only(seed: int) -> None:
    rng = np.random.default_rng(seed)
    group = Category.HAMMER_HEAD.symmetry
    R, R_prior = Rotation.random(2, rng=rng).as_matrix()
    fixed, variance = fix_spin(R, R_prior, group, FREE_SPIN_VARIANCE, np.deg2rad(10) ** 2)
    np.testing.assert_allclose(fixed[:, 2], R[:, 2], atol=1e-9)
    # Nothing of the prior's twist is left to replace, and its variance is taken over.
    assert abs(twist_angles((fixed.T @ R_prior)[None], np.array([0.0, 0.0, 1.0]))[0]) < 1e-6
    assert variance == pytest.approx(np.deg2rad(10) ** 2, rel=0.02)


@pytest.mark.parametrize("turn", [0.0, 90.0, 200.0])
def test_a_free_spin_is_the_one_of_the_hand_s_own_grasp(turn: float) -> None:
    """Of another hand that holds the same tool turned about its face's normal, which is the tool's x axis."""
    R_camera_hand = Rotation.random(rng=np.random.default_rng(3)).as_matrix()
    R_hand_tool = SHADOW_HAND.grasp.R_hand_tool @ Rotation.from_euler("x", turn, degrees=True).as_matrix()
    R_true = R_camera_hand @ R_hand_tool @ Category.HAMMER_HEAD.spec.R_tool_ee
    seen = transform(R_true @ Rotation.from_euler("z", 77, degrees=True).as_matrix(), [0.0, 0.0, 0.6])
    hypotheses = PoseHypotheses(seen[None], np.zeros((0, 3)), 0.001, 0.01, 0.0)
    free = PoseResult(
        Category.HAMMER_HEAD, seen, FREE_SPIN_VARIANCE * np.eye(6), 1.0, True, "ok", hypotheses,
        np.zeros(0), np.zeros(3),
    )  # fmt: skip
    held = with_hand(free, HoldingHand(transform(R_camera_hand, [0.1, 0.0, 0.6]), R_hand_tool))
    np.testing.assert_allclose(held.X_camera_ee[:3, :3], R_true, atol=1e-9)


def test_a_well_seen_spin_outweighs_the_hand() -> None:
    group = Category.HAMMER_HEAD.symmetry
    R_prior = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    fixed, variance = fix_spin(np.eye(3), R_prior, group, np.deg2rad(2) ** 2, np.deg2rad(20) ** 2)
    turned = float(twist_angles(fixed[None], np.array([0.0, 0.0, 1.0]))[0])
    assert 0 < turned < np.deg2rad(1)
    assert variance < np.deg2rad(2) ** 2


def test_c2_takes_the_reading_nearest_to_the_hand_and_no_symmetry_changes_nothing() -> None:
    wrench = Category.WRENCH_HEAD.symmetry
    flipped = wrench.elements()[1]
    fixed, _ = fix_spin(flipped, Rotation.from_euler("y", 30, degrees=True).as_matrix(), wrench, 1.0, 0.1)
    np.testing.assert_allclose(fixed, np.eye(3), atol=1e-12)
    same, _ = fix_spin(flipped, np.eye(3), GROUPS[0], 1.0, 0.1)
    np.testing.assert_array_equal(same, flipped)


@pytest.mark.parametrize(
    "kind", [ToolKind.CLAW_HAMMER, ToolKind.PHILLIPS_SCREWDRIVER, ToolKind.COMBINATION_WRENCH], ids=lambda k: k.value
)
def test_nominal_ee_orientations_are_those_of_the_tools(kind: ToolKind) -> None:
    tool = make_tool(kind, train_seeds(1)[0])
    ee = tool.ees[0]
    error = ee.category.symmetry.rotation_error(ee.category.spec.R_tool_ee, ee.X_tool_ee[:3, :3])
    assert error < np.deg2rad(25)
    if kind is ToolKind.CLAW_HAMMER:
        claw = tool.ee(Category.HAMMER_GRIP)
        spread = claw.category.symmetry.rotation_error(claw.category.spec.R_tool_ee, claw.X_tool_ee[:3, :3])
        assert spread < np.deg2rad(50)
