"""Lenses against librealsense's and OpenCV's own projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from tests.examples import examples
from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.errors import NotReadyError
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


@examples(20)
@given(
    coefficients=COEFFICIENTS,
    model=st.sampled_from([LensModel.BROWN_CONRADY, LensModel.MODIFIED_BROWN_CONRADY]),
    focal=st.floats(0.9, 1.5),
)
def test_a_direction_that_is_distorted_and_undistorted_is_itself(
    coefficients: tuple[float, ...], model: LensModel, focal: float
) -> None:
    k = CameraIntrinsics(focal * 424, focal * 424, 213.2, 119.1, 424, 240)
    lens = Lens(k, model, coefficients)
    v, u = np.mgrid[: k.height, : k.width]
    back = lens.distort(lens.rays().astype(np.float64))
    assert np.abs(back - np.stack([u, v])).max() < 0.01, "a hundredth of a pixel"
    assert lens.largest_difference(lens) == 0.0


@examples(20)
@given(coefficients=COEFFICIENTS)
def test_undistorted_depth_is_the_depth_of_a_pixel_that_is_there(coefficients: tuple[float, ...]) -> None:
    """No depth arises between two surfaces, and what no pixel saw has none."""
    lens = Lens(PINHOLE, LensModel.BROWN_CONRADY, coefficients)
    depth = np.where(np.indices((240, 424)).sum(axis=0) // 9 % 2, 0.5, 1.25).astype(np.float32)
    undistorted = lens.undistortion().depth(depth)
    assert set(np.unique(undistorted)) <= {np.float32(v) for v in (0.0, 0.5, 1.25)}
    x, y = np.meshgrid((np.arange(424) - PINHOLE.cx) / PINHOLE.fx, (np.arange(240) - PINHOLE.cy) / PINHOLE.fy)
    u, v = lens.distort(np.stack([x, y]))
    outside = (u < -0.51) | (u > 423.51) | (v < -0.51) | (v > 239.51)
    assert np.all(undistorted[outside] == 0)
    inside = (u > -0.49) & (u < 423.49) & (v > -0.49) & (v < 239.49)
    assert np.all(undistorted[inside] > 0)


def test_the_largest_displacement_is_in_the_corner() -> None:
    lens = Lens(PINHOLE, LensModel.BROWN_CONRADY, (0.06, 0.0, 0.0, 0.0))
    v, u = np.mgrid[0:240:239, 0:424:423]
    x, y = lens.rays()[:, v, u]
    corner = np.hypot(PINHOLE.fx * x + PINHOLE.cx - u, PINHOLE.fy * y + PINHOLE.cy - v).max()
    assert lens.largest_displacement() == pytest.approx(corner, abs=1e-3)
    assert 4.0 < corner < 6.0
    assert Lens(PINHOLE).largest_displacement() == 0.0


def test_coefficients_of_no_lens_are_refused() -> None:
    """Where the polynomial turns back inside the image, its outer pixels see nothing."""
    with raises(NotReadyError, "not_ready.camera_lens"):
        Lens(PINHOLE, LensModel.BROWN_CONRADY, (-1.5, 0.0, 0.0, 0.0, 0.0)).undistortion()


def test_beyond_the_turn_of_the_polynomial_nothing_is_known() -> None:
    """A wide lens whose polynomial holds as far as its image reaches, and no farther."""
    k = CameraIntrinsics(160.0, 160.0, 159.5, 119.5, 320, 240)
    lens = Lens(k, LensModel.BROWN_CONRADY, (0.05, -0.045, 0.0, 0.0, 0.0))
    depth = lens.undistortion().depth(np.ones((240, 320), np.float32))
    r = np.hypot(*np.meshgrid((np.arange(320) - k.cx) / k.fx, (np.arange(240) - k.cy) / k.fy))
    radial = 1 + 0.05 * 3 * r**2 - 0.045 * 5 * r**4  # of the derivative
    assert np.all(depth[radial < 0] == 0)


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
    np.testing.assert_array_equal(lens.undistortion().color(image), image)
