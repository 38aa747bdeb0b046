"""Lenses against librealsense's and OpenCV's own projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from toolee_robot.hardware.cameras.lens import Lens, LensModel
from toolee_robot.types import CameraIntrinsics

PINHOLE = CameraIntrinsics(390.0, 391.0, 213.2, 119.1, 424, 240)
COEFFICIENTS = st.tuples(
    st.floats(-0.15, 0.15), st.floats(-0.1, 0.1), st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3), st.floats(-0.05, 0.05)
)


@examples(10)
@given(coefficients=COEFFICIENTS, name=st.sampled_from(["brown_conrady", "inverse_brown_conrady"]))
def test_rays_are_those_of_librealsense(coefficients: tuple[float, ...], name: str) -> None:
    rs = pytest.importorskip("pyrealsense2", exc_type=ImportError)
    theirs = rs.intrinsics()
    theirs.width, theirs.height, theirs.fx, theirs.fy = PINHOLE.width, PINHOLE.height, PINHOLE.fx, PINHOLE.fy
    theirs.ppx, theirs.ppy, theirs.coeffs = PINHOLE.cx, PINHOLE.cy, list(coefficients)
    theirs.model = getattr(rs.distortion, name)
    model = LensModel.BROWN_CONRADY if name == "brown_conrady" else LensModel.MODIFIED_BROWN_CONRADY
    rays = Lens(PINHOLE, model, coefficients).rays()
    for u, v in ((0, 0), (423, 239), (30, 200), (213, 119), (400, 20)):
        pixel = rs.rs2_project_point_to_pixel(theirs, [*map(float, rays[:, v, u]), 1.0])
        assert np.abs(np.subtract(pixel, (u, v))).max() < 0.01, "a hundredth of a pixel"


@examples(10)
@given(coefficients=COEFFICIENTS)
def test_rays_project_back_to_their_pixels(coefficients: tuple[float, ...]) -> None:
    rays = Lens(PINHOLE, LensModel.BROWN_CONRADY, coefficients).rays()
    points = np.concatenate([rays.reshape(2, -1).T, np.ones((rays[0].size, 1))], axis=1).astype(np.float64)
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), PINHOLE.matrix, np.array(coefficients))
    v, u = np.mgrid[: PINHOLE.height, : PINHOLE.width]
    assert np.abs(pixels.reshape(-1, 2) - np.stack([u.ravel(), v.ravel()], axis=1)).max() < 0.02


@pytest.mark.parametrize("model", [LensModel.BROWN_CONRADY, LensModel.MODIFIED_BROWN_CONRADY])
def test_undistortion_puts_each_pixel_on_its_ray(model: LensModel) -> None:
    lens = Lens(PINHOLE, model, (0.08, -0.1, 8e-4, -5e-4, 0.02))
    undistortion, ideal = lens.undistortion(), Lens(PINHOLE).rays()
    for of_lens, of_pinhole in zip(lens.rays(), ideal, strict=True):
        # What the undistorted image shows, were a pixel's value the direction that it sees.
        seen = cv2.remap(of_lens, undistortion.coarse, undistortion.fine, cv2.INTER_LINEAR)
        assert np.abs(seen - of_pinhole)[20:-20, 20:-20].max() < 0.05 / PINHOLE.fx, "a twentieth of a pixel"


def test_without_distortion_nothing_moves() -> None:
    lens = Lens(PINHOLE, LensModel.BROWN_CONRADY, (0.0,) * 5)
    assert not lens.distorts
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (PINHOLE.height, PINHOLE.width, 3)).astype(np.uint8)
    np.testing.assert_array_equal(lens.undistortion()(image), image)
