"""The symmetry groups are groups, and the error modulo a group ignores exactly the group."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.strategies import rotations
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, rotation_angle
from toolee_robot.symmetry import SymmetryGroup

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
