"""Registration of depth to colour: on scenes whose true depth is known, and at the edges of what can come in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.registration import COLORS, measure_registration
from tests.examples import examples
from toolee_robot.devices.cameras.lens import DepthRegistration, Lens
from toolee_robot.frames import transform
from toolee_robot.types import CameraIntrinsics

SMALL = CameraIntrinsics(60.0, 60.0, 31.5, 23.5, 64, 48)


@pytest.mark.parametrize("color", COLORS)
def test_depth_lies_within_half_a_pixel(color: str) -> None:
    figures = measure_registration(color, seed=5, scenes=4, repeats=4)
    assert figures.surface_rms < 0.5
    assert figures.edge_rms < 0.55
    assert abs(figures.edge_mean) < 0.25
    assert figures.surface_most < 1.1, "a footprint's corner"
    assert figures.holes < 0.002


def test_the_same_camera_keeps_its_depth() -> None:
    rng = np.random.default_rng(0)
    depth = np.where(rng.random((48, 64)) < 0.1, np.nan, 0.5 + rng.random((48, 64))).astype(np.float32)
    register = DepthRegistration(Lens(SMALL), SMALL, np.eye(4))
    np.testing.assert_allclose(register(depth), np.nan_to_num(depth), atol=1e-6)


def test_the_nearer_surface_hides_the_farther_one() -> None:
    depth = np.full((48, 64), 1.0, np.float32)
    depth[:, 30:40] = 0.5
    registered = DepthRegistration(Lens(SMALL), SMALL, transform(np.eye(3), [0.1, 0.0, 0.0]))(depth)
    row = registered[24]
    # 0.1 m are 6 px at 1 m and 12 px at 0.5 m.
    assert np.all(row[42:52] == 0.5)
    assert np.all(row[7:36] == 1.0)
    assert np.all(row[36:42] == 0.0), "what the depth camera does not see behind it stays unknown"
    assert np.all(row[:6] == 0.0)


def test_depth_is_along_the_colour_cameras_axis() -> None:
    angle = np.deg2rad(5.0)
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    register = DepthRegistration(Lens(SMALL), SMALL, transform(R, [0.0, 0.0, 0.02]))
    depth = np.zeros((48, 64), np.float32)
    depth[24, 40] = 0.8
    x = (40 - 31.5) / 60
    y = (24 - 23.5) / 60
    X, Y, Z = R @ [0.8 * x, 0.8 * y, 0.8] + [0, 0, 0.02]
    registered = register(depth)
    v, u = np.argwhere(registered > 0)[0]
    assert abs(registered[v, u] - Z) < 1e-5
    assert abs(60 * X / Z + 31.5 - u) <= 0.61
    assert abs(60 * Y / Z + 23.5 - v) <= 0.61


@examples(40)
@given(
    values=st.lists(st.sampled_from([0.0, np.nan, np.inf, -1.0, 1e-6, 0.3, 2.0, 1e6]), min_size=12, max_size=12),
    shift=st.tuples(*(st.floats(-2.0, 2.0),) * 3),
    turn=st.floats(-3.0, 3.0),
)
def test_whatever_comes_in_depth_comes_out(values: list[float], shift: tuple[float, float, float], turn: float) -> None:
    depth = np.resize(np.array(values, np.float32), (48, 64))
    R = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    registered = DepthRegistration(Lens(SMALL), SMALL, transform(R, shift))(depth)
    assert registered.shape == (48, 64)
    assert registered.dtype == np.float32
    assert np.all(np.isfinite(registered))
    assert np.all(registered >= 0)
