"""What has changed around a nail since it was set, in drawn images of orange wood with a grain."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.perception.nail.appearance import Appearance, NailPose, Window
from toolee_robot.perception.nail.change import AsSet, Change, fit_moved
from toolee_robot.types import CameraIntrinsics

SIZE = 48
WINDOW = Window(8, 6, 40, 40)
WOOD, STEEL = np.array([170.0, 130.0, 80.0]), np.array([90.0, 90.0, 95.0])
FOOT, HEAD = np.zeros(3), np.array([0.0, 0.0, 0.008])
COVARIANCE = 0.0005**2 * np.eye(4)


@pytest.fixture
def look() -> Appearance:
    """Half a metre above the nail, 2.5 mm a pixel, 45 degrees from the vertical."""
    s = np.sqrt(0.5)
    X_camera_base = np.eye(4)
    X_camera_base[:3, :3] = [[1.0, 0.0, 0.0], [0.0, -s, -s], [0.0, s, -s]]
    X_camera_base[:3, 3] = [0.0, 0.0, 0.5]
    half = 0.5 * (SIZE - 1)
    return Appearance(CameraIntrinsics(200.0, 200.0, half, half, SIZE, SIZE), X_camera_base, 0.0011, 0.0025, 0.5)


@pytest.fixture
def grain() -> NDArray[np.float64]:
    """How bright the wood is, (SIZE, SIZE)."""
    return np.asarray(np.random.default_rng(1).normal(1.0, 0.05, (SIZE, SIZE)))


def _drawn(
    look: Appearance, grain: NDArray[np.float64], pose: NailPose, steel: Array, seed: int
) -> NDArray[np.float64]:
    """A nail on wood, (SIZE, SIZE, 3)."""
    covered = look.covered(Window(0, 0, SIZE, SIZE), pose).sum(axis=1).reshape(SIZE, SIZE, 1)
    drawn = (1.0 - covered) * grain[..., None] * WOOD + covered * steel
    return np.asarray(drawn + np.random.default_rng(seed).normal(0.0, 1.5, drawn.shape))


def _moved(look: Appearance, grain: NDArray[np.float64], later: NDArray[np.float64]) -> Array:
    was = NailPose(FOOT, np.array([0.0, 0.0, 0.020]))
    first, everywhere = _drawn(look, grain, was, STEEL, 2), np.ones((SIZE, SIZE), bool)
    before = AsSet(look, was, COVARIANCE, np.stack([STEEL - WOOD, STEEL - WOOD]), first, everywhere)
    change = Change(before, later, WINDOW, everywhere)
    return fit_moved(change, NailPose(FOOT, HEAD), COVARIANCE).offset


@pytest.mark.parametrize("aside", [(0.0, 0.0), (0.005, 0.0), (-0.003, 0.004), (0.0, -0.005)])
@pytest.mark.parametrize("brighter", [-30.0, 0.0, 60.0])
def test_a_nail_that_turns_to_other_lamps_is_found_where_it_is(
    look: Appearance, grain: NDArray[np.float64], aside: tuple[float, float], brighter: float
) -> None:
    later = _drawn(look, grain, NailPose(FOOT, HEAD + np.array([*aside, 0.0])), STEEL + brighter, 3)
    assert np.linalg.norm(_moved(look, grain, later) - aside) < 0.0015


def test_a_shadow_and_a_lamp_that_is_dimmed_move_no_head(look: Appearance, grain: NDArray[np.float64]) -> None:
    shaded = grain.copy()
    shaded[:, SIZE // 2 + 3 :] *= 0.9
    later = 0.85 * _drawn(look, shaded, NailPose(FOOT, HEAD), STEEL, 3)
    assert np.linalg.norm(_moved(look, grain, later)) < 0.0015
