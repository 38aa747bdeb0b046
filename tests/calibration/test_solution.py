"""The solution: accuracy and coverage by protocol, its derivatives, and the mistakes that it names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.calibration import LARGEST_ERROR, measure
from benchmarks.calibration_poses import Protocol, SyntheticSet, draw
from tests.calibration.pictures import BOARD, CAMERA
from tests.examples import seldom
from toolee_robot.calibration.hand_eye.diagnosis import check_depths
from toolee_robot.calibration.hand_eye.reprojection import Estimate, Views
from toolee_robot.calibration.hand_eye.solve import calibrate
from toolee_robot.calibration.observation import Observation
from toolee_robot.errors import UserError
from toolee_robot.frames import HALF_TURN, Array, inverse, transform

X_BASE_CAMERA = CAMERA.X_base_camera
PLACE = X_BASE_CAMERA[:3, 3]


def _draw(protocol: Protocol, seed: int = 1) -> SyntheticSet:
    return draw(protocol, BOARD, CAMERA.intrinsics, X_BASE_CAMERA, np.random.default_rng(seed))


@pytest.mark.parametrize("protocol", seldom("15 poses", *(name for name in LARGEST_ERROR if name != "15 poses")))
def test_the_error_that_is_asked_for_is_met_and_the_region_has_the_truth(protocol: str) -> None:
    figures = measure(protocol, BOARD, CAMERA.intrinsics, X_BASE_CAMERA, runs=30)
    assert figures.error <= LARGEST_ERROR[protocol]
    assert figures.error < figures.closed_form, "the refinement is worth it"
    assert figures.covered >= 0.8  # 95 % asked; `benchmarks.calibration` measures it on 200 runs
    assert figures.refused == 0


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31))
def test_the_derivatives_are_those_of_the_projection(seed: int) -> None:
    drawn = _draw(Protocol(3), seed)
    views = Views(drawn.observations, BOARD, CAMERA.intrinsics)
    estimate = Estimate(drawn.X_base_camera, drawn.X_flange_board)
    projection = views.project(estimate)
    step = 1e-6
    for k in range(13):
        d = np.zeros(13)
        d[k] = step
        change = (views.project(estimate.moved(d)).residuals - views.project(estimate.moved(-d)).residuals) / (2 * step)
        np.testing.assert_allclose(projection.by_parameters[..., k], change, atol=2e-3)
    for k in range(6):
        moved = []
        for sign in (1, -1):
            e = np.zeros(6)
            e[k] = sign * step
            R = Rotation.from_rotvec(e[3:]).as_matrix()
            shifted = [
                replace(o, X_base_flange=transform(R @ o.X_base_flange[:3, :3], o.X_base_flange[:3, 3] + e[:3]))
                for o in drawn.observations
            ]
            moved.append(Views(shifted, BOARD, CAMERA.intrinsics).project(estimate).residuals)
        np.testing.assert_allclose(projection.by_flange[..., k], (moved[0] - moved[1]) / (2 * step), atol=2e-3)


def test_wrong_poses_hardly_count_and_are_named() -> None:
    calibration = calibrate(_draw(Protocol(20, outliers=3)).observations, BOARD, CAMERA.intrinsics, expected=PLACE)
    assert calibration.wrong == ["000", "001", "002"]
    off = (calibration.X_base_camera - X_BASE_CAMERA) @ [0.0, 0.0, 0.95, 1.0]
    assert np.linalg.norm(off) < 1e-3
    assert calibration.target_radius > np.linalg.norm(off)


def test_a_clean_set_has_small_held_out_errors_and_a_board_of_its_size() -> None:
    calibration = calibrate(_draw(Protocol(20)).observations, BOARD, CAMERA.intrinsics, expected=PLACE)
    assert calibration.wrong == []
    assert calibration.leave_one_out.residual < 1.5e-3
    assert calibration.leave_one_out.shifts.max() < 1e-3
    scale, sigma = calibration.scale
    assert abs(scale - 1.0) < 4 * sigma < 0.01
    assert calibration.methods["Horaud"] < 0.05


def _transposed(X: Array) -> Array:
    return transform(X[:3, :3].T, X[:3, 3])


def _mirrored(X: Array) -> Array:
    P = np.eye(4)[[1, 0, 2, 3]]
    return np.asarray(P @ X @ P)


def _as_wxyz(X: Array) -> Array:
    x, y, z, w = Rotation.from_matrix(X[:3, :3]).as_quat()
    return transform(Rotation.from_quat([w, x, y, z]), X[:3, 3])


MISTAKES: dict[str, tuple[Callable[[Array], Array], str, str]] = {
    "the pendant's Base taken for base_link": (lambda X: HALF_TURN @ X, "user.calibration_half_turn", "half a turn"),
    "the inverse of each pose": (inverse, "user.calibration_misfit", "X_flange_base"),
    "transposed rotations": (_transposed, "user.calibration_misfit", "transposed"),
    "x and y swapped": (_mirrored, "user.calibration_misfit", "x and y swapped"),
    "quaternions in another order": (_as_wxyz, "user.calibration_misfit", "quaternions"),
    "millimetres": (lambda X: transform(X[:3, :3], 1e3 * X[:3, 3]), "user", "metres"),
    "no rotations": (lambda X: transform(1.01 * X[:3, :3], X[:3, 3]), "user", "rigid"),
}


@pytest.mark.parametrize("mistake", seldom(*MISTAKES))
def test_a_classic_mistake_is_refused_by_its_name(mistake: str) -> None:
    change, code, words = MISTAKES[mistake]
    observations = [replace(o, X_base_flange=change(o.X_base_flange)) for o in _draw(Protocol(20)).observations]
    with pytest.raises(UserError, match=words) as error:
        calibrate(observations, BOARD, CAMERA.intrinsics, expected=PLACE)
    assert error.value.code == code


@pytest.mark.nightly
def test_images_that_lag_behind_the_poses_are_noticed() -> None:
    given = _draw(Protocol(20)).observations
    later = [replace(o, X_base_flange=p.X_base_flange) for o, p in zip(given, given[1:] + given[:1], strict=True)]
    with pytest.raises(UserError, match="shifted by one"):
        calibrate(later, BOARD, CAMERA.intrinsics)


def _refused(observations: list[Observation], expected: Array | None = None) -> UserError:
    with pytest.raises(UserError) as error:
        calibrate(observations, BOARD, CAMERA.intrinsics, expected=expected)
    return error.value


def test_poses_that_determine_nothing_are_refused() -> None:
    assert "7 poses show the board" in str(_refused(_draw(Protocol(7)).observations))
    for seed in range(10):
        flat = _draw(Protocol(20, tilt=float(np.deg2rad(10.0))), seed)
        assert "Both need" in str(_refused(flat.observations))


@pytest.mark.parametrize("scale", seldom(0.992, 0.97, 1.01))
def test_a_board_of_another_scale_is_noticed_by_the_arms_motions(scale: float) -> None:
    assert "the squares are not" in str(_refused(_draw(Protocol(30, scale=scale)).observations))


def test_a_camera_elsewhere_and_other_intrinsics_are_refused() -> None:
    drawn = _draw(Protocol(20)).observations
    assert _refused(drawn, PLACE + np.array([0.0, 0.5, 0.0])).code == "user.calibration_place"
    rng = np.random.default_rng(0)
    noisy = [
        replace(o, view=replace(o.view, pixels=o.view.pixels + rng.normal(0.0, 3.0, o.view.pixels.shape)))
        for o in drawn
    ]
    assert _refused(noisy).code == "user.calibration_image"


@pytest.mark.parametrize(
    ("factor", "words"), [(1e3, "depth_unit is wrong"), (1e-3, "depth_unit is wrong"),
                         (1.2, "not registered to"), (1.02, None)],
)  # fmt: skip
def test_the_depths_unit_is_checked(factor: float, words: str | None) -> None:
    depth = np.random.default_rng(0).uniform(0.5, 1.0, 200)
    measured = np.where(np.arange(200) % 3, factor * depth, 0.0)
    if words is None:
        check_depths(measured, depth)
        return
    with pytest.raises(UserError, match=words):
        check_depths(measured, depth)
