"""The depth sensor's noise against its formula, and its failures where they belong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from toolee_robot.depth_noise import DepthNoise
from toolee_robot.render.sensor_models import Photo, measure_depth, photograph
from toolee_robot.types import CameraIntrinsics

K = CameraIntrinsics(365.5, 365.5, 254.9, 205.4, 512, 424)
SHAPE = (K.height, K.width)
NOISELESS = DepthNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.02, 0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0, 1e3, 0.0)


def flat(z: float) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    return np.full(SHAPE, z, np.float32)


@pytest.mark.parametrize("z", [0.5, 0.8, 1.1, 2.0])
@pytest.mark.parametrize("degrees", [0.0, 40.0, 65.0])
@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_axial_noise_has_the_published_deviation(z: float, degrees: float, correlation: float) -> None:
    noise = replace(DepthNoise(), correlation=correlation, quantum=0.0, random_dropout=0.0)
    cos = flat(float(np.cos(np.deg2rad(degrees))))
    depth = measure_depth(flat(z), cos, flat(0.0), K, noise, np.random.default_rng(1))
    theta = np.deg2rad(degrees)
    expected = 1e-3 * (1.5 - 0.5 * z + 0.3 * z**2 + 0.1 * z**1.5 * theta**2 / (np.pi / 2 - theta) ** 2)
    inner = depth[20:-20, 20:-20]
    inner = inner[inner > 0]
    assert np.std(inner) == pytest.approx(expected, rel=0.05)
    assert np.mean(inner) == pytest.approx(z, abs=1e-4)


def test_readings_are_whole_millimetres() -> None:
    depth = measure_depth(flat(0.8), flat(1.0), flat(0.0), K, DepthNoise(), np.random.default_rng(0))
    mm = depth * 1000
    np.testing.assert_allclose(mm, np.round(mm), atol=1e-3)


def test_edges_mix_or_drop_and_flat_parts_do_not() -> None:
    scene = flat(1.0)
    scene[:, 256:] = 0.7
    depth = measure_depth(
        scene, flat(1.0), flat(0.0), K, replace(DepthNoise(), random_dropout=0.0), np.random.default_rng(3)
    )
    between = (depth > 0.73) & (depth < 0.97)
    lost = depth == 0
    assert between[:, 250:262].mean() > 0.02
    assert lost[:, 250:262].mean() > 0.01
    assert not between[:, :240].any()
    assert not between[:, 272:].any()
    assert not lost[:, 272:].any()


def test_shiny_and_grazing_surfaces_drop_out() -> None:
    rng = np.random.default_rng(4)
    slanted = flat(float(np.cos(np.deg2rad(50))))
    dull = measure_depth(flat(0.7), slanted, flat(0.0), K, DepthNoise(), rng)
    shiny = measure_depth(flat(0.7), slanted, flat(0.9), K, DepthNoise(), rng)
    grazing = measure_depth(flat(0.7), flat(float(np.cos(np.deg2rad(89)))), flat(0.0), K, DepthNoise(), rng)
    assert np.mean(dull == 0) < 0.01
    assert 0.1 < np.mean(shiny == 0) < 0.4
    assert np.mean(grazing == 0) > 0.8


def test_noiseless_is_the_identity_and_holes_stay_holes() -> None:
    scene = flat(0.9)
    scene[100:150, 100:150] = 0.0
    exact = measure_depth(scene, flat(1.0), flat(0.0), K, NOISELESS, np.random.default_rng(0))
    np.testing.assert_array_equal(exact, scene)
    noisy = measure_depth(scene, flat(1.0), flat(0.0), K, DepthNoise(), np.random.default_rng(0))
    assert np.all(noisy[100:150, 100:150] == 0)


def test_random_sensors_and_cameras_are_reproducible() -> None:
    def once() -> tuple[object, object, bytes]:
        rng = np.random.default_rng(11)
        noise, photo = DepthNoise.random(rng), Photo.random(rng)
        image = np.broadcast_to(np.arange(512, dtype=np.uint8)[None, :, None] // 2, (*SHAPE, 3))
        return noise, photo, photograph(np.ascontiguousarray(image), photo, rng).tobytes()

    assert once() == once()
