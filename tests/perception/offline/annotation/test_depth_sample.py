"""Depth at a click: the near surface, and no depth where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from tests.errors import raises
from tests.perception.offline.annotation.scenes import CAMERA
from toolee_robot.errors import UserError
from toolee_robot.perception.offline.annotation.measurements import depth_sigma, noise_factor, sample_depth
from toolee_robot.types import RgbdFrame


def _frame(depth: np.ndarray) -> RgbdFrame:
    return RgbdFrame(np.zeros((*depth.shape, 3), np.uint8), depth.astype(np.float32), CAMERA)


def _wall(z: float = 0.8) -> np.ndarray:
    return np.full((CAMERA.height, CAMERA.width), z)


def test_at_an_edge_it_is_the_near_surface_s_and_where_that_is() -> None:
    depth = _wall()
    depth[:, :201] = 0.5
    sample = sample_depth(_frame(depth), (201.0, 100.0))
    assert sample.z == pytest.approx(0.5)
    assert sample.pixel[0] == pytest.approx(199.5)
    assert len(sample.pixels) == 10


def test_mixed_pixels_do_not_move_it() -> None:
    depth = _wall()
    depth[:, 195:200] = 0.5
    depth[:, 200] = np.linspace(0.5, 0.8, CAMERA.height)
    assert sample_depth(_frame(depth), (198.0, 212.0)).z == pytest.approx(0.5)


def test_one_wrong_pixel_in_front_is_no_surface() -> None:
    depth = _wall()
    depth[100, 200] = 0.3
    assert sample_depth(_frame(depth), (200.0, 100.0)).z == pytest.approx(0.8)


@pytest.mark.parametrize("unknown", [0.0, np.nan])
def test_a_hole_is_refused(unknown: float) -> None:
    depth = _wall()
    depth[90:111, 190:211] = unknown
    with raises(UserError, code="user.no_depth_at_click"):
        sample_depth(_frame(depth), (200.0, 100.0))


def test_depth_that_cannot_be_the_tool_s_is_none() -> None:
    with raises(UserError, code="user.no_depth_at_click"):
        sample_depth(_frame(_wall()), (200.0, 100.0), (0.4, 0.6))


def test_a_click_outside_is_refused() -> None:
    with raises(UserError, code="user.click_outside"):
        sample_depth(_frame(_wall()), (-3.0, 100.0))


def test_its_standard_deviation_is_that_of_medians_of_white_noise_or_more() -> None:
    rng = np.random.default_rng(0)
    truth, medians, sigmas = 0.7, [], []
    for _ in range(200):
        sample = sample_depth(
            _frame(_wall(truth) + rng.normal(0, 0.0013, (CAMERA.height, CAMERA.width))), (200.0, 100.0)
        )
        medians.append(sample.z - truth)
        sigmas.append(depth_sigma(sample, 0.0, len(sample.pixels)))
    assert np.std(medians) < np.mean(sigmas) < 5 * np.std(medians)


def test_shared_pixels_count_once_and_noise_is_seen() -> None:
    rng = np.random.default_rng(0)
    sample = sample_depth(_frame(_wall(0.7) + rng.normal(0, 0.006, (CAMERA.height, CAMERA.width))), (200.0, 100.0))
    n = len(sample.pixels)
    assert depth_sigma(sample, 0.0, n / 2) > depth_sigma(sample, 0.0, n)
    assert noise_factor([sample], 0.0) > 3.0
