"""The crop about the hand that holds the tool: it shows all of the region, and no more than it must."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from toolee_robot.frames import random_rotation, transform
from toolee_robot.perception.detection.inputs import MAX_ENLARGEMENT
from toolee_robot.perception.detection.passes import PIXELS, hand_crop
from toolee_robot.types import CameraIntrinsics, HeldRegion

CAMERA = CameraIntrinsics(365.5, 380.0, 254.9, 205.4, 512, 424)


@given(
    seed=st.integers(0, 2**31),
    points=hnp.arrays(float, (3, 3), elements=st.floats(-0.2, 0.2)),
    radius=st.floats(0.01, 0.3),
    place=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.3, 1.5)),
)
def test_what_the_camera_sees_of_the_region_is_in_the_crop(
    seed: int, points: np.ndarray, radius: float, place: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(seed)
    X = transform(random_rotation(rng), place)
    crop = hand_crop(X, HeldRegion(points, radius), CAMERA)
    weights = rng.dirichlet(np.ones(len(points)), 300)
    away = rng.normal(size=(300, 3))
    away *= radius * rng.uniform(0.9, 1.0, (300, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    inside = weights @ points @ X[:3, :3].T + X[:3, 3] + away
    inside = inside[inside[:, 2] > 0.01]
    u = CAMERA.fx * inside[:, 0] / inside[:, 2] + CAMERA.cx
    v = CAMERA.fy * inside[:, 1] / inside[:, 2] + CAMERA.cy
    seen = (np.round(u) >= 0) & (np.round(u) < CAMERA.width) & (np.round(v) >= 0) & (np.round(v) < CAMERA.height)
    # Pixel centres are at integer coordinates; half a pixel at the image's border is not worth a look.
    if crop is None:
        assert np.count_nonzero((u > 1) & (u < CAMERA.width - 2) & (v > 1) & (v < CAMERA.height - 2)) == 0
        return
    columns, rows = np.round(u[seen]), np.round(v[seen])
    assert ((columns >= crop.x0) & (columns < crop.x1) & (rows >= crop.y0) & (rows < crop.y1)).all()


def test_a_ball_s_crop_is_its_outline_to_the_network_s_stride() -> None:
    crop = hand_crop(transform(p=(0.0, 0.0, 0.8)), HeldRegion(np.zeros((1, 3)), 0.1), CAMERA)
    assert crop is not None
    scale = crop.size[1] / (crop.x1 - crop.x0)
    assert scale == pytest.approx(MAX_ENLARGEMENT, rel=0.02)
    outline = 2 * 0.1 * CAMERA.fx / np.sqrt(0.8**2 - 0.1**2)
    assert outline <= crop.x1 - crop.x0 <= outline + 1 + 32 / scale


def test_a_near_hand_is_shown_smaller() -> None:
    crop = hand_crop(transform(p=(0.0, 0.0, 0.4)), HeldRegion(np.zeros((1, 3)), 0.19), CAMERA)
    assert crop is not None
    assert crop.size[0] * crop.size[1] == pytest.approx(PIXELS, rel=0.25)
    assert crop.size[1] < crop.x1 - crop.x0 or crop.size[0] < crop.y1 - crop.y0


@pytest.mark.parametrize("p", [(0.0, 0.0, -0.8), (2.0, 0.0, 0.8), (0.0, -2.0, 0.8)])
def test_a_hand_that_the_camera_does_not_see_has_no_crop(p: tuple[float, float, float]) -> None:
    assert hand_crop(transform(p=p), HeldRegion(np.zeros((1, 3)), 0.1), CAMERA) is None


def test_a_hand_about_the_camera_is_looked_for_everywhere() -> None:
    crop = hand_crop(transform(p=(0.0, 0.0, 0.05)), HeldRegion(np.zeros((1, 3)), 0.1), CAMERA)
    assert crop is not None
    assert (crop.x0, crop.y0, crop.x1, crop.y1) == (0, 0, 512, 424)
