"""Intrinsics from images: the true ones within their uncertainty, and what does not determine them is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.calibration.pictures import BOARD, CAMERA, picture
from tests.errors import raises
from toolee_robot.calibration.intrinsics import DISTORTED_FLAT, calibrate_intrinsics
from toolee_robot.calibration.observation import BoardView, find_board
from toolee_robot.calibration.record import IntrinsicsRecord, read_intrinsics, write_record
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import Array, transform

SIZE = (CAMERA.width, CAMERA.height)
K = CAMERA.intrinsics


def _views(tilt: float, count: int = 24, lens: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] = lambda i: i,
           spread: float = 0.32) -> list[BoardView]:  # fmt: skip
    rng = np.random.default_rng(5)
    views: list[BoardView] = []
    while len(views) < count:
        R = Rotation.from_rotvec([*rng.uniform(-tilt, tilt, 2), 0.0]) * Rotation.from_rotvec([0, 0, rng.uniform(-1, 1)])
        depth = rng.uniform(0.36, 0.6)
        center = depth * np.array([rng.uniform(-spread, spread), rng.uniform(-spread, spread) * 0.8, 1.0])
        view = find_board(
            lens(picture(BOARD, transform(R, center - R.as_matrix() @ BOARD.center))), BOARD, DISTORTED_FLAT
        )
        if view is not None:
            views.append(view)
    return views  # fmt: skip


def _calibrate(views: list[BoardView]) -> IntrinsicsRecord:
    return calibrate_intrinsics(
        views, BOARD, SIZE, camera_serial="cam-7", software="0", measured_at="2026-11-25T00:00:00+00:00"
    )


@pytest.fixture(scope="module")
def tilted() -> list[BoardView]:
    return _views(0.7)


def test_the_true_intrinsics_are_found_within_their_uncertainty(tilted: list[BoardView]) -> None:
    record = _calibrate(tilted)
    found = record.intrinsics
    for mine, true, sigma in zip(
        (found.fx, found.fy, found.cx, found.cy), (K.fx, K.fy, K.cx, K.cy), record.sigma, strict=True
    ):
        assert abs(mine - true) < max(4 * sigma, 0.3)
    assert not record.distorts
    assert record.held_out < 0.3


def test_a_distorting_lens_is_noticed() -> None:
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=np.float32), np.arange(SIZE[1], dtype=np.float32))
    true = np.array([0.06, 0.0, 0.0, 0.0])
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(pixels, K.matrix, true, P=K.matrix).reshape(SIZE[1], SIZE[0], 2).astype(np.float32)
    x, y = ideal[..., 0].copy(), ideal[..., 1].copy()
    record = _calibrate(_views(0.7, lens=lambda i: np.asarray(cv2.remap(i, x, y, cv2.INTER_CUBIC), np.uint8)))
    assert record.distorts
    assert record.distortion[0] == pytest.approx(0.06, abs=max(4 * record.sigma_distortion[0], 0.01))
    assert record.intrinsics.fx == pytest.approx(K.fx, abs=max(4 * record.sigma[0], 1.0))


def test_corners_that_do_not_fit_are_left_out(tilted: list[BoardView]) -> None:
    """As those that the edge of the image cuts."""
    rng, wrong, views = np.random.default_rng(0), 0, []
    for view in tilted:
        off = rng.random(len(view.ids)) < 0.03
        views.append(replace(view, pixels=view.pixels + off[:, None] * rng.choice([-3.0, 3.0], view.pixels.shape)))
        wrong += int(off.sum())
    record, clean = _calibrate(views), _calibrate(tilted)
    assert wrong <= record.left_out <= wrong + 8 + clean.left_out
    assert record.held_out < 1.2 * clean.held_out
    assert record.intrinsics.fx == pytest.approx(clean.intrinsics.fx, abs=0.3)


@pytest.mark.nightly
def test_what_does_not_determine_them_is_refused(tilted: list[BoardView]) -> None:
    with raises(UserError, "user.intrinsics_few_views"):
        _calibrate(tilted[:9])
    with raises(UserError, "user.intrinsics_coverage"):
        _calibrate(_views(0.7, 12, spread=0.02))
    with raises(UserError, "user.intrinsics_undetermined"):
        _calibrate(_views(0.03))
    rng = np.random.default_rng(0)
    shaken = [replace(view, pixels=view.pixels + rng.normal(0.0, 2.5, view.pixels.shape)) for view in tilted * 2]
    with raises(UserError, "user.intrinsics_misfit"):
        _calibrate(shaken)


def _through(projection: Callable[[Array], Array], edge: float) -> list[BoardView]:
    """Views through a lens that is no polynomial's, three of four in the middle of the image.

    Args:
        projection: Distance from the image's middle of an angle from the axis [rad], in focal lengths.
        edge: Angle in the middle of the image's shorter sides [rad].
    """
    rng, views = np.random.default_rng(7), list[BoardView]()
    focal = 0.5 * SIZE[0] / float(projection(np.array(edge)))
    while len(views) < 40:
        R = Rotation.from_rotvec([*rng.uniform(-0.7, 0.7, 2), 0.0]) * Rotation.from_rotvec([0, 0, rng.uniform(-1, 1)])
        angle = edge * (rng.uniform(0.7, 1.1) if len(views) % 4 == 0 else rng.uniform(0.0, 0.3))
        around = rng.uniform(0.0, 2 * np.pi)
        toward = np.array([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])
        R = Rotation.align_vectors([toward], [[0.0, 0.0, 1.0]])[0] * R
        points = (BOARD.corners - BOARD.center) @ R.as_matrix().T + rng.uniform(0.5, 0.8) * toward
        r = np.hypot(points[:, 0], points[:, 1])
        theta = np.arctan2(r, points[:, 2])
        pixels = focal * (projection(theta) / r)[:, None] * points[:, :2] + np.array(SIZE) / 2
        pixels += rng.normal(0.0, 0.1, pixels.shape)
        seen = (theta < 1.5) & np.all((pixels > 0) & (pixels < np.array(SIZE) - 1), axis=1)
        if seen.sum() >= 12:
            views.append(BoardView(np.flatnonzero(seen), pixels[seen]))
    return views


def _bent(theta: Array) -> Array:
    """A pinhole camera's up to 0.45 rad, a fisheye's beyond."""
    return np.asarray(np.tan(np.minimum(theta, 0.45)) + 0.6 * np.maximum(theta - 0.45, 0.0))


@pytest.mark.parametrize(
    ("projection", "edge", "words"), [(_bent, 0.8, "do not fit the others"), (np.sin, 1.3, "took no part")]
)
def test_a_lens_that_four_numbers_do_not_describe_is_refused(
    projection: Callable[[Array], Array], edge: float, words: str
) -> None:
    """Also where what does not fit, left out, leaves a middle that does."""
    with raises(UserError, "user.intrinsics_misfit") as error:
        _calibrate(_through(projection, edge))
    assert words in str(error.value)


def test_a_record_of_intrinsics_is_signed(tilted: list[BoardView], tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("intrinsics") / "intrinsics.json"
    record = _calibrate(tilted)
    write_record(path, record)
    assert read_intrinsics(path) == record
    path.write_text(path.read_text().replace('"cam-7"', '"cam-8"'))
    with raises(ConfigError, "config.calibration_altered"):
        read_intrinsics(path)
