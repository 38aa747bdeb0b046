"""Protrusion from a contact and slip between two looks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.control import merge, protrusion, slip
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform
from toolee_robot.station import sim_station
from toolee_robot.types import InHandEstimate

SURE = np.eye(6) * 1e-6
VAGUE = np.diag([2e-3**2] * 3 + [0.04**2] * 3)


def estimate(X_hand_ee: Array, category: Category = Category.HAMMER_HEAD, covariance: Array = SURE) -> InHandEstimate:
    return InHandEstimate(category, X_hand_ee, covariance, 0.9, 5, 5, True, "ok")


@given(
    height=st.floats(-0.002, 0.03),
    aside=st.floats(-0.008, 0.008),
    tilt_deg=st.floats(-10, 10),
    spin=st.floats(-3.1, 3.1),
)
def test_protrusion_is_where_the_faces_plane_cuts_the_axis(
    height: float, aside: float, tilt_deg: float, spin: float
) -> None:
    work = sim_station().work
    X_base_nail = work.X_base_nail(height)
    # The face touches the head's centre with a point that is `aside` of its own centre.
    X_nail_ee = transform(Rotation.from_euler("zy", [spin, np.deg2rad(tilt_deg)])) @ transform(p=[aside, 0, 0])
    assert protrusion(X_base_nail @ X_nail_ee, work.X_base_nail(0.0)) == pytest.approx(height, abs=1e-9)


def test_a_face_turned_away_is_no_contact() -> None:
    work = sim_station().work
    upside_down = work.X_base_nail() @ transform(Rotation.from_euler("x", np.pi))
    with raises(UserError, code="user.face_direction"):
        protrusion(upside_down, work.X_base_nail(0.0))


@given(spin=st.floats(-3.1, 3.1), tilt=st.floats(0, 0.5), shift=st.floats(0, 0.05))
def test_slip_ignores_the_symmetric_spin(spin: float, tilt: float, shift: float) -> None:
    before = transform(Rotation.from_euler("xyz", [0.2, -1.0, 0.4]), [0.01, -0.02, 0.2])
    moved = before @ transform(Rotation.from_euler("xz", [tilt, spin]))
    moved[:3, 3] += [shift, 0, 0]
    distance, angle = slip(estimate(before), estimate(moved))
    assert distance == pytest.approx(shift, abs=1e-12)
    assert angle == pytest.approx(tilt, abs=1e-7)


def test_a_claw_has_no_free_spin_and_is_no_face() -> None:
    spun = transform(Rotation.from_euler("z", 0.3))
    _, angle = slip(estimate(np.eye(4), Category.HAMMER_GRIP), estimate(spun, Category.HAMMER_GRIP))
    assert angle == pytest.approx(0.3)
    with raises(UserError, code="user.different_categories"):
        slip(estimate(np.eye(4)), estimate(np.eye(4), Category.HAMMER_GRIP))


def test_equal_looks_meet_half_way_and_share_their_error() -> None:
    tilt = transform(Rotation.from_euler("y", 4, degrees=True), [0.004, 0, 0])
    merged = merge(estimate(np.eye(4), covariance=VAGUE), estimate(tilt, covariance=VAGUE), 0.0, 0.0)
    np.testing.assert_allclose(merged.X_hand_ee[:3, 3], [0.002, 0, 0], atol=1e-9)
    assert merged.category.symmetry.rotation_error(merged.X_hand_ee[:3, :3], np.eye(3)) == pytest.approx(np.deg2rad(2))
    np.testing.assert_allclose(merged.covariance, VAGUE)


def test_a_tool_that_slipped_further_than_it_drifts_is_where_the_new_look_says() -> None:
    slipped = estimate(transform(Rotation.from_euler("y", 12, degrees=True), [0.012, 0, 0]), covariance=VAGUE)
    assert merge(estimate(np.eye(4), covariance=VAGUE), slipped, 0.001, 0.005) is slipped


def test_after_much_drift_the_new_look_counts() -> None:
    moved = transform(p=[0.01, 0, 0])
    merged = merge(estimate(np.eye(4)), estimate(moved), 0.1, 0.1)
    np.testing.assert_allclose(merged.X_hand_ee[:3, 3], [0.01, 0, 0], atol=1e-5)


@given(spin=st.floats(-3.1, 3.1))
def test_the_free_spin_does_not_disturb_a_merge(spin: float) -> None:
    X = transform(Rotation.from_euler("xy", [20, 10], degrees=True), [0.2, 0, 0.1])
    merged = merge(estimate(X), estimate(X @ transform(Rotation.from_euler("z", spin))), 0.001, 0.01)
    np.testing.assert_allclose(merged.X_hand_ee[:3, 2], X[:3, 2], atol=1e-9)
    np.testing.assert_allclose(merged.X_hand_ee[:3, 3], X[:3, 3], atol=1e-9)
