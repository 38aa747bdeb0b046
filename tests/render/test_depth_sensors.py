"""Depth cameras that triangulate, systematic errors of time of flight, and registration, against their formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.examples import seldom
from toolee_robot.depth_noise import KINDS, DepthNoise, SensorKind
from toolee_robot.perception.offline.synthesis.example import Series, make_example
from toolee_robot.render.depth_sensors import SystematicErrors, measure_depth, random_reading
from toolee_robot.render.material import Rendering
from toolee_robot.render.triangulation import (
    Registration,
    Surface,
    TriangulatingCamera,
    hidden_from,
)
from toolee_robot.types import CameraIntrinsics

K = CameraIntrinsics(365.5, 365.5, 254.9, 205.4, 512, 424)
SHAPE = (K.height, K.width)


def wall(z: float, shininess: float = 0.0, brightness: float = 0.5) -> Surface:
    return Surface(
        *(np.full(SHAPE, value, np.float32) for value in (z, 1.0, shininess, brightness)),
    )


def step_scene(near: float = 0.6, far: float = 1.0) -> np.ndarray:
    depth = np.full(SHAPE, far, np.float32)
    depth[100:300, 200:300] = near
    return depth


def camera(filled: bool = False, **changes: float) -> TriangulatingCamera:
    usual = {"baseline": 0.075, "focal": 580.0, "noise": 0.08, "shared": 0.5, "step": 1e-3, "window": 9.0}
    none = {"fattening": 0.0, "polished": 0.0, "dark": 0.0, "slant": 0.1, "nearest": 0.3}
    return TriangulatingCamera(**(usual | none | changes), filled=filled)


@settings(max_examples=15, deadline=None)
@given(z=st.floats(0.5, 2.0), noise=st.floats(0.05, 0.2), shared=st.floats(0.0, 0.8))
def test_the_noise_grows_with_the_square_of_the_distance(z: float, noise: float, shared: float) -> None:
    reading = camera(noise=noise, shared=shared).measure(wall(z), K, np.random.default_rng(1))
    known = reading[reading > 0]
    assert len(known) > 0.95 * reading.size
    assert np.std(known) == pytest.approx(noise * z**2 / (580.0 * 0.075), rel=0.15)
    assert np.mean(known) == pytest.approx(z, rel=2e-3)


def test_structured_light_reads_in_steps_of_an_eighth_of_a_pixel() -> None:
    reading = camera(step=0.125, noise=0.1).measure(wall(1.0), K, np.random.default_rng(2))
    disparity = 580.0 * 0.075 / reading[reading > 0] / 0.125
    np.testing.assert_allclose(disparity, np.round(disparity), atol=1e-3)


@pytest.mark.parametrize("baseline", [0.05, -0.05])
def test_the_shadow_is_as_wide_as_the_step_in_disparity(baseline: float) -> None:
    depth = step_scene()
    hidden = hidden_from(depth, K, baseline)
    expected = K.fx * abs(baseline) * (1 / 0.6 - 1 / 1.0)
    assert hidden[200].sum() == pytest.approx(expected, abs=2.0)
    beside = np.flatnonzero(hidden[200])
    # The second eye at the right (+x) loses what lies left of the nearer thing.
    assert np.all(beside < 200) if baseline > 0 else np.all(beside >= 300)
    assert not hidden[50].any()


def test_outlines_grow_where_the_nearer_side_wins() -> None:
    surface = wall(1.0)
    surface = Surface(step_scene(), surface.cos_incidence, surface.shininess, surface.brightness)
    size = {}
    for share in (0.0, 1.0):
        reading = camera(fattening=share, noise=0.0, baseline=1e-4, step=1e-9).measure(
            surface, K, np.random.default_rng(5)
        )
        size[share] = np.count_nonzero(np.abs(reading - 0.6) < 0.01)
    half = round(0.5 * 9.0 * K.fx / 580.0)
    assert size[1.0] - size[0.0] > 0.5 * half * 2 * (200 + 100)


@pytest.mark.parametrize(
    ("surface", "lossy"),
    [(wall(0.8, shininess=1.0), camera(polished=0.5)), (wall(0.8, brightness=0.0), camera(dark=0.5))],
)
def test_polished_and_black_surfaces_are_lost_in_patches(surface: Surface, lossy: TriangulatingCamera) -> None:
    lost = lossy.measure(surface, K, np.random.default_rng(6)) == 0
    assert 0.3 < lost.mean() < 0.7
    # Patches: a lost pixel's neighbour is mostly lost, too.
    assert lost[:, 1:][lost[:, :-1]].mean() > 0.8
    assert not (camera().measure(surface, K, np.random.default_rng(6)) == 0).any()


def test_a_driver_that_fills_leaves_no_hole_behind_a_thing() -> None:
    surface = wall(1.0)
    surface = Surface(step_scene(), surface.cos_incidence, surface.shininess, surface.brightness)
    holes = {
        filled: (camera(filled=filled).measure(surface, K, np.random.default_rng(7))[:, 60:] == 0).mean()
        for filled in (False, True)
    }
    assert holes[False] > 0.01
    assert holes[True] == 0


def test_registration_shifts_the_depth_and_loses_what_the_depth_camera_cannot_see() -> None:
    depth = step_scene()
    moved = Registration(0.0, (3.0, -2.0)).apply(depth, depth, K)
    np.testing.assert_array_equal(moved[:-2, 3:], depth[2:, :-3])
    shadowed = Registration(0.05, (0.0, 0.0)).apply(depth, depth, K)
    np.testing.assert_array_equal(shadowed == 0, hidden_from(depth, K, 0.05))


def test_time_of_flight_in_a_lab_errs_by_distance_darkness_and_polish() -> None:
    none = {"wiggle": 0.0, "period": 0.5, "phase": 0.0, "black": 0.0, "detour": 0.0, "holes": 0.0, "nearest": 0.3}

    def seen(surface: Surface, **changes: float) -> np.ndarray:
        return SystematicErrors(**(none | changes)).seen(surface, K.fx, np.random.default_rng(8))

    assert seen(wall(0.625), wiggle=0.005).mean() == pytest.approx(0.625 + 0.005, abs=1e-5)
    assert seen(wall(0.8, brightness=0.0), black=0.01).mean() == pytest.approx(0.81, abs=1e-5)
    assert seen(wall(0.8, brightness=1.0), black=0.01).mean() == pytest.approx(0.80, abs=1e-5)
    assert seen(wall(0.8, shininess=1.0), detour=0.01).min() >= np.float32(0.8)
    assert 0.3 < (seen(wall(0.8, shininess=1.0), holes=0.5) == 0).mean() < 0.7
    assert not seen(wall(0.29)).any()


@pytest.mark.parametrize("kind", seldom(*KINDS))
def test_every_kind_takes_the_same_picture_with_its_own_depth(kind: SensorKind) -> None:
    usual = make_example(Series(4242), 3)
    example = make_example(Series(4242, sensor=kind), 3)
    again = make_example(Series(4242, sensor=kind), 3)
    np.testing.assert_array_equal(example.depth_mm, again.depth_mm)
    np.testing.assert_array_equal(example.ee, usual.ee)
    known = (example.depth_mm > 0) & (usual.depth_mm > 0)
    assert known.mean() > 0.4
    depth = usual.depth_mm[known].astype(float)
    error = np.abs(example.depth_mm[known] - depth) / (depth / 1000) ** 2
    assert np.median(error) < 15  # mm at a metre
    assert (kind == "time-of-flight") == np.array_equal(example.depth_mm, usual.depth_mm)


@settings(max_examples=15, deadline=None)
@given(shared=st.floats(0.0, 1.0), frames=st.integers(2, 6), seed=st.integers(0, 1000))
def test_what_neighbours_share_no_number_of_frames_averages_out(shared: float, frames: int, seed: int) -> None:
    """The pattern stands still: of n frames' mean the variance s + (1 - s) / n is left."""
    one, noise = camera(shared=shared, noise=0.1), np.random.default_rng(seed)
    fb = one.focal * one.baseline
    errors = [fb / one.measure(wall(1.0), K, noise, np.random.default_rng([seed, 1])) - fb for _ in range(frames)]
    left = np.var(np.mean(errors, axis=0)) / np.var(errors[0])
    assert left == pytest.approx(shared + (1.0 - shared) / frames, abs=0.05)


@pytest.mark.parametrize("kind", seldom(*KINDS[1:-1]))
def test_the_errors_of_one_camera_stay_with_its_pixels(kind: SensorKind) -> None:
    """What it loses and bends in one frame it does in the next one, whatever else has come into the image."""
    depth, cos = np.full(SHAPE, 0.7, np.float32), np.full(SHAPE, 0.6, np.float32)
    shine = np.zeros(SHAPE, np.float32)
    shine[:, :256] = 1.0
    color, ids = np.full((*SHAPE, 3), 60, np.uint8), np.zeros(SHAPE, np.int16)
    empty = Rendering(color, depth, ids, cos, shine)
    something = depth.copy()
    something[300:] = 0.45
    looked_at = (slice(20, 280), slice(60, 450))

    def like(one: np.ndarray, other: np.ndarray) -> float:
        """How much two frames' errors are alike, where a lost pixel counts as one of 30 mm."""
        errors = [np.where(frame > 0, np.clip(frame - 0.7, -0.03, 0.03), -0.03)[looked_at] for frame in (one, other)]
        return float(np.corrcoef(errors[0].ravel(), errors[1].ravel())[0, 1])

    same, others = [], []
    for seed in range(8):

        def read(image: Rendering, frame: int, fields: int, seed: int = seed) -> np.ndarray:
            streams = (np.random.default_rng([seed, stream]) for stream in (4, fields, 100 + frame))
            drawn, still, noise = streams
            return random_reading(kind, image, K, drawn, fields=still, noise=noise)

        first = read(empty, 0, 5)
        same.append(like(first, read(Rendering(color, something, ids, cos, shine), 1, 5)))
        others.append(like(first, read(empty, 1, 6)))
    assert np.median(same) > 0.5
    assert np.median(same) > np.median(others) + 0.25


@pytest.mark.parametrize("kind", seldom("time-of-flight", "time-of-flight-lab"))
def test_one_camera_errs_alike_in_every_frame(kind: SensorKind) -> None:
    """A job's frames are of one camera: only its noise is new in each."""
    flat = (np.full(SHAPE, value, np.float32) for value in (1.0, 0.0))
    seen = Rendering(
        np.full((*SHAPE, 3), 120, np.uint8), np.full(SHAPE, 0.7, np.float32), np.zeros(SHAPE, np.int16), *flat
    )

    def error(camera: int, frame: int) -> float:
        drawn, noise = np.random.default_rng(camera), np.random.default_rng([camera, frame])
        reading = random_reading(kind, seen, K, drawn, noise=noise)
        return float(np.median(reading[reading > 0])) - 0.7

    errors = np.array([[error(camera, frame) for frame in range(3)] for camera in range(6)])
    assert np.all(np.ptp(errors, axis=1) < 1e-4)
    assert np.std(errors[:, 0]) > 5e-4


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
