"""The records refuse what they cannot mean, and a trajectory is the motion its samples describe."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.strategies import rotations, transforms
from toolee_robot.end_effectors import CATEGORIES, END_EFFECTORS, Category, label_of
from toolee_robot.errors import UserError
from toolee_robot.frames import (
    Array,
    angle_between,
    frame_from_axes,
    inverse,
    is_rigid,
    rotation_angle,
    transform,
    transform_points,
)
from toolee_robot.perception.detection.detector import CLASSES
from toolee_robot.symmetry import SymmetryGroup
from toolee_robot.tools import TOOL_SPECS, make_tool
from toolee_robot.types import CameraIntrinsics, InHandEstimate, RgbdFrame, Trajectory

_K = CameraIntrinsics(300.0, 300.0, 4.0, 3.0, 8, 6)


def _cubic(coefficients: np.ndarray, times: np.ndarray) -> Trajectory:
    """A trajectory sampled from cubics, coefficients (4, n), constant first."""
    powers = np.stack([times**k for k in range(4)])
    d1 = np.stack([0 * times, 0 * times + 1, 2 * times, 3 * times**2])
    d2 = np.stack([0 * times, 0 * times, 0 * times + 2, 6 * times])
    return Trajectory(times, powers.T @ coefficients, d1.T @ coefficients, d2.T @ coefficients)


@given(st.lists(st.floats(-2, 2), min_size=8, max_size=8), st.floats(0, 1))
def test_sampling_is_exact_for_cubics_between_uneven_samples(values: list[float], t: float) -> None:
    c = np.array(values).reshape(4, 2)
    trajectory = _cubic(c, np.array([0.0, 0.13, 0.2, 0.71, 1.0]))
    q, qd = trajectory.sample(t)
    np.testing.assert_allclose(q, np.array([1, t, t**2, t**3]) @ c, atol=1e-9)
    np.testing.assert_allclose(qd, np.array([0, 1, 2 * t, 3 * t**2]) @ c, atol=1e-8)


def test_a_trajectory_holds_its_ends_and_knows_its_duration() -> None:
    trajectory = _cubic(np.array([[0.5], [1.0], [0.0], [-0.2]]), np.linspace(0.0, 0.4, 5))
    assert trajectory.duration == pytest.approx(0.4)
    np.testing.assert_allclose(trajectory.sample(-1.0)[0], trajectory.q[0])
    np.testing.assert_allclose(trajectory.sample(9.0)[0], trajectory.q[-1])


@pytest.mark.parametrize("times", [[0.1, 0.2], [0.0, 0.0], [0.0, -1.0], [0.0, float("nan")], [0.0]])
def test_times_that_do_not_run_forward_from_zero_are_refused(times: list[float]) -> None:
    n = len(times)
    with pytest.raises(ValueError, match="traject"):
        Trajectory(np.array(times), np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6)))


def test_joint_arrays_of_different_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="inconsistent"):
        Trajectory(np.array([0.0, 1.0]), np.zeros((2, 6)), np.zeros((2, 5)), np.zeros((2, 6)))


@pytest.mark.parametrize(
    ("rgb", "depth", "cause"),
    [
        (np.zeros((6, 8), np.uint8), np.zeros((6, 8), np.float32), "rgb must be"),
        (np.zeros((6, 8, 3), np.float32), np.zeros((6, 8), np.float32), "rgb must be"),
        (np.zeros((6, 8, 3), np.uint8), np.zeros((3, 4), np.float32), "differ in size"),
        (np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8), np.uint16), "depth must be float"),
        (np.zeros((5, 8, 3), np.uint8), np.zeros((5, 8), np.float32), "the intrinsics are for"),
    ],
)
def test_a_frame_that_does_not_fit_together_is_refused(rgb: np.ndarray, depth: np.ndarray, cause: str) -> None:
    with pytest.raises(UserError, match=cause):
        RgbdFrame(rgb, depth, _K)


def test_the_sigma_of_a_position_is_that_of_its_worst_direction() -> None:
    covariance = np.diag([1e-6, 4e-6, 1e-6, 0.02**2, 0.03**2, 0.01**2])
    estimate = InHandEstimate(Category.HAMMER_HEAD, np.eye(4), covariance, 0.9, 5, 5, True, "ok")
    assert estimate.sigma_position == pytest.approx(0.002)


@pytest.mark.parametrize("shape", [(), (5,), (3, 4)])
def test_rays_are_the_other_way_round_than_projections(shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(0).integers(0, 8, (*shape, 2))
    rays = _K.rays(pixels)
    assert rays.shape == (*shape, 3)
    np.testing.assert_array_equal(rays[..., 2], 1.0)
    np.testing.assert_allclose(_K.project(0.7 * rays), pixels, atol=1e-12)


def test_inverse_takes_batches() -> None:
    rng = np.random.default_rng(0)
    Xs = np.stack([frame_from_axes(z=rng.normal(size=3), x=rng.normal(size=3), p=rng.normal(size=3)) for _ in range(6)])
    Xs = Xs.reshape(2, 3, 4, 4)
    np.testing.assert_allclose(Xs @ inverse(Xs), np.broadcast_to(np.eye(4), Xs.shape), atol=1e-12)


@pytest.mark.parametrize(
    "X",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),  # a reflection
        2.0 * np.eye(4),
        np.full((4, 4), np.nan),
    ],
)
def test_an_array_that_is_no_rigid_transform_is_recognised(X: Array) -> None:
    assert not is_rigid(X)


@given(transforms(), st.integers(1, 5))
def test_points_and_their_way_back(X_AB: Array, n: int) -> None:
    p_B = np.random.default_rng(n).normal(size=(n, 3))
    p_A = transform_points(X_AB, p_B)
    np.testing.assert_allclose(p_A[0], (X_AB @ [*p_B[0], 1.0])[:3], atol=1e-12)
    np.testing.assert_allclose(transform_points(inverse(X_AB), p_A), p_B, atol=1e-9)


@given(rotations())
def test_rotation_angle_is_the_norm_of_the_logarithm_and_symmetric(R: Array) -> None:
    angle = rotation_angle(R)
    assert 0.0 <= angle <= np.pi + 1e-9
    assert angle == pytest.approx(rotation_angle(R.T), abs=1e-6)
    assert np.trace(R) == pytest.approx(1 + 2 * np.cos(angle), abs=1e-6)


def test_angles_near_zero_and_pi_are_not_lost() -> None:
    e_x, tiny = np.array([1.0, 0.0, 0.0]), 1e-9
    assert angle_between(e_x, np.array([1.0, tiny, 0.0])) == pytest.approx(tiny, rel=1e-6)
    assert angle_between(e_x, np.array([-1.0, tiny, 0.0])) == pytest.approx(np.pi - tiny)


def test_a_frame_from_axes_keeps_z_and_turns_x_as_little_as_it_must() -> None:
    X = frame_from_axes(z=np.array([0.0, 0.0, 3.0]), x=np.array([2.0, 0.0, 5.0]), p=[1.0, 2.0, 3.0])
    assert is_rigid(X)
    np.testing.assert_allclose(X, transform(np.eye(3), [1.0, 2.0, 3.0]), atol=1e-12)
    with pytest.raises(ValueError, match="parallel"):
        frame_from_axes(z=np.array([0.0, 0.0, 1.0]), x=np.array([0.0, 0.0, -2.0]))


_groups = st.sampled_from([c.symmetry for c in Category])


def _contains(elements: Array, R: Array) -> bool:
    return min(rotation_angle(g.T @ R) for g in elements) < 1e-6


@pytest.mark.parametrize("category", list(Category))
def test_group_axioms(category: Category) -> None:
    elements = category.symmetry.elements(steps=12)
    assert _contains(elements, np.eye(3))
    for g in elements:
        assert _contains(elements, g.T), "the inverse is missing"
        for h in elements:
            assert _contains(elements, g @ h), "not closed"


@given(_groups, rotations(), st.integers(0, 63))
def test_members_of_the_orbit_are_at_distance_zero(group: SymmetryGroup, R: Array, k: int) -> None:
    elements = group.elements()
    assert group.rotation_error(R, R @ elements[k % len(elements)]) < 1e-6


@given(_groups, rotations(), rotations())
def test_the_error_is_symmetric_and_at_most_the_plain_angle(group: SymmetryGroup, A: Array, B: Array) -> None:
    error = group.rotation_error(A, B)
    assert error == pytest.approx(group.rotation_error(B, A), abs=1e-6)
    assert error <= rotation_angle(A.T @ B) + 1e-6


@given(_groups, rotations(), rotations(), rotations())
def test_the_error_does_not_depend_on_the_camera(group: SymmetryGroup, A: Array, B: Array, R_camera: Array) -> None:
    assert group.rotation_error(R_camera @ A, R_camera @ B) == pytest.approx(group.rotation_error(A, B), abs=1e-6)


@given(_groups, rotations(), rotations())
def test_canonical_stays_in_the_orbit_and_is_its_closest_member(group: SymmetryGroup, R: Array, target: Array) -> None:
    chosen = group.canonical(R, target)
    assert group.rotation_error(R, chosen) < 1e-6
    best = min(rotation_angle((R @ g).T @ target) for g in group.elements(256))
    assert rotation_angle(chosen.T @ target) <= best + 1e-6


def test_a_hammers_spin_does_not_count_and_its_tilt_does() -> None:
    group = Category.HAMMER_HEAD.symmetry
    spin, tilt = Rotation.from_rotvec([0, 0, 1.3]).as_matrix(), Rotation.from_rotvec([0.2, 0, 0]).as_matrix()
    assert group.rotation_error(np.eye(3), spin) == pytest.approx(0.0, abs=1e-9)
    assert group.rotation_error(np.eye(3), tilt) == pytest.approx(0.2)


def test_a_wrench_may_be_turned_over_but_not_round() -> None:
    group = Category.WRENCH_HEAD.symmetry
    over, round_ = Rotation.from_rotvec([np.pi, 0, 0]).as_matrix(), Rotation.from_rotvec([0, 0, np.pi]).as_matrix()
    assert group.rotation_error(np.eye(3), over) == pytest.approx(0.0, abs=1e-6)
    assert group.rotation_error(np.eye(3), round_) == pytest.approx(np.pi, abs=1e-6)


def test_class_ids_count_from_one_in_the_order_of_the_names() -> None:
    assert tuple(Category) == CATEGORIES
    assert [category.spec.class_id for category in Category] == list(range(1, len(Category) + 1))
    assert [CLASSES[category.spec.class_id] for category in Category] == [str(category) for category in Category]


def test_the_ids_of_data_sets_and_weights_stay_what_they_are() -> None:
    assert [str(category) for category in CATEGORIES[:4]] == [
        "hammer_head", "hammer_grip", "screwdriver_head", "wrench_head",
    ]  # fmt: skip


def test_records_are_complete_and_tell_the_categories_apart() -> None:
    specs = END_EFFECTORS.values()
    assert sum(spec.training_share for spec in specs) == pytest.approx(1.0)
    for spec in specs:
        assert is_rigid(transform(spec.R_tool_ee))
        assert spec.radius > 0
        assert spec.frame.startswith("origin")
    for values in ([spec.label for spec in specs], [spec.color for spec in specs]):
        assert len(set(values)) == len(values)


def test_every_category_is_an_end_of_some_kind_of_tool_and_its_spin_cues_are_parts_of_it() -> None:
    for category in Category:
        kinds = [kind for kind, spec in TOOL_SPECS.items() if category in spec.end_effectors]
        assert kinds
        labels = {part.label for kind in kinds for seed in range(6) for part in make_tool(kind, seed).parts}
        assert set(category.spec.spin_cues) <= labels


def test_labels_are_for_people() -> None:
    assert label_of("hammer_grip") == "claw"
    assert label_of("class_average") == "class average"


def test_axes_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Category.HAMMER_HEAD.spec.R_tool_ee[0, 0] = 1.0
    np.testing.assert_array_equal(Category.SCREWDRIVER_HEAD.spec.R_tool_ee, np.eye(3))
