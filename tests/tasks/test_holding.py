"""How the hand holds the tool, by two looks at it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, angle_between, transform
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import STEADY, STEADY_ANGLE, holding_between
from toolee_robot.types import InHandEstimate, Payload

BEFORE = transform(Rotation.from_rotvec([0.1, 0.7, -2.0]), [0.2, -0.03, 0.1])
USUAL = np.deg2rad(0.4)
HELD = HeldTool.nominally(BEFORE, Payload(0.6, np.array([0.0, 0.02, -0.1])))


def seen(X: Array, sigma: float = 1e-4) -> InHandEstimate:
    covariance = np.diag([1e-6] * 3 + [sigma**2] * 3)
    return InHandEstimate(Category.HAMMER_HEAD, X, covariance, 0.9, 2, 2, True, "ok")


@given(st.floats(-np.pi, np.pi), st.floats(0.001, 0.2), st.floats(-3.0, 3.0), st.integers(1, 12))
def test_what_is_seen_clearly_goes_on_as_it_was(direction: float, angle: float, spin: float, strikes: int) -> None:
    turn = transform(Rotation.from_rotvec([angle * np.cos(direction), angle * np.sin(direction), 0.0]))
    # The spin about the normal is the hand's, and no turn of the face.
    now = BEFORE @ turn @ transform(Rotation.from_rotvec([0.0, 0.0, spin]))
    _, turned = holding_between(seen(BEFORE), seen(now), strikes, USUAL)
    held = replace(HELD, turn=turned)
    for _ in range(strikes):
        held = held.turned()
    X = held.X_hand_ee
    assert angle_between(X[:3, 2], now[:3, 2]) < 0.01 * angle + 1e-9
    np.testing.assert_array_equal(X[:3, 3], BEFORE[:3, 3])


def test_what_is_seen_badly_is_believed_in_part() -> None:
    now = BEFORE @ transform(Rotation.from_rotvec([np.deg2rad(2.0), 0.0, 0.0]))
    turns = [holding_between(seen(BEFORE, s), seen(now, s), 4, USUAL)[1][0] for s in np.deg2rad([0.01, 0.5, 1.0, 5.0])]
    assert np.all(np.diff(turns) < 0.0)
    assert 4 * turns[0] == pytest.approx(np.deg2rad(2.0), rel=0.01)
    assert 0.0 < 4 * turns[-1] < np.deg2rad(0.2)


@pytest.mark.parametrize(
    ("aside", "along", "angle", "steady"),
    [
        (0.0, 0.0, 0.0, True),
        (3.9 * STEADY, 0.0, 3.9 * STEADY_ANGLE, True),
        (0.0, 0.012, 0.0, True),
        (4.1 * STEADY, 0.0, 0.0, False),
        (0.0, 0.0, 4.1 * STEADY_ANGLE, False),
    ],
)
def test_a_tool_that_slips_along_the_normal_alone_is_steady(
    aside: float, along: float, angle: float, steady: bool
) -> None:
    """Touches measure that slip."""
    now = BEFORE @ transform(Rotation.from_rotvec([angle, 0.0, 0.0]), [aside, 0.0, along])
    assert holding_between(seen(BEFORE), seen(now), 4, USUAL)[0] is steady


def test_of_one_look_nothing_is_concluded() -> None:
    np.testing.assert_array_equal(HELD.turned().X_hand_ee, BEFORE)
    assert not HELD.steady


def test_a_weighed_tools_centre_of_mass_stays_in_the_hand_and_a_told_ones_with_the_face() -> None:
    now = BEFORE @ transform(Rotation.from_rotvec([0.0, 0.2, 0.0]), [0.0, 0.0, 0.01])
    assert HELD.moved(now).payload is HELD.payload
    weighed = replace(HELD, weighed=True)
    in_hand = [
        X @ np.append(held.payload.center_of_mass, 1.0) for X, held in ((BEFORE, weighed), (now, weighed.moved(now)))
    ]
    np.testing.assert_allclose(in_hand[0], in_hand[1], atol=1e-12)
