"""The second renderer against the built-in one's rays, and its camera against light of a known colour."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion

from toolee_robot.frames import transform
from toolee_robot.render import Body, Material, Scene
from toolee_robot.render.mesh import box, cylinder, plane, sphere
from toolee_robot.render.path_tracing.camera_response import CameraResponse
from toolee_robot.render.path_tracing.surroundings import Surroundings
from toolee_robot.render.path_tracing.traced import PathTracedView
from toolee_robot.render.renderer import Shot
from toolee_robot.render.scene import Backdrop
from toolee_robot.types import CameraIntrinsics

pytestmark = pytest.mark.sim

K = CameraIntrinsics(70.0, 70.0, 45.3, 30.8, 96, 64)
X_WORLD_CAMERA = transform(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), (0.1, 0.2, 0.3))
X_AHEAD = transform(p=(0.8, 0.15, 0.35))
PLAIN = CameraResponse(0.0, 0.3, 0.0, 0.0, 0.0, 1e6, 1.0, 0.0, (1.0, 1.0, 1.0), 4.0, 1.0, 1.0, 0.0, 0.0, 96)


def scene(background: bool = True) -> Scene:
    bodies = [
        Body(box((0.1, 0.2, 0.15)), X_AHEAD, Material(metallic=1.0, roughness=0.3), 1),
        Body(cylinder(0.04, 0.3), transform(p=(0.6, 0.22, 0.25)), Material(), 2),
        Body(sphere(0.06), transform(p=(0.7, 0.25, 0.45)), Material(roughness=0.9), 3),
        Body(plane(14.0), transform(p=(0.0, 0.0, -0.2)), Material(), 100),
    ]
    return Scene(bodies, background=Backdrop((0, 0, 0), (0, 0, 0), (0, 0, 0)) if background else None)


def view(seed: int = 0, background: bool = True) -> PathTracedView:
    return PathTracedView(scene(background), K, X_WORLD_CAMERA, Surroundings(), np.random.default_rng(seed))


def test_depth_and_ids_are_those_of_the_built_in_rays() -> None:
    seen, shot = view(), Shot(scene(), K, X_WORLD_CAMERA)
    there = shot.body_ids != 100  # in a panorama, walls and floors are left out
    inside = np.zeros_like(there)
    for body_id in (1, 2, 3):
        ours, theirs = shot.body_ids == body_id, seen.body_ids == body_id
        assert ours.sum() > 100
        assert not np.any(theirs & ~binary_dilation(ours))
        assert not np.any(binary_erosion(ours) & ~theirs)
        inside |= ours & theirs
    assert np.abs(seen.depth - shot.depth)[inside].max() < 1e-3
    assert np.all(seen.depth[there & (shot.body_ids < 0)] == 0)
    assert np.all(seen.cos_incidence[inside] > 0)
    assert np.all(seen.shininess[seen.body_ids == 1] > seen.shininess[seen.body_ids == 3].max())


def test_a_body_alone_is_seen_through_what_hides_it() -> None:
    seen, shot = view(), Shot(scene(), K, X_WORLD_CAMERA)
    region = (20, 10, 80, 60)
    alone, ours = seen.depth_of(1, region), shot.depth_of(1, region)
    assert alone.shape == (50, 60)
    assert np.mean((alone > 0) != (ours > 0)) < 0.01
    both = (alone > 0) & (ours > 0)
    assert np.abs(alone - ours)[both].max() < 1e-3
    assert both.sum() > (shot.body_ids == 1).sum()


@pytest.mark.parametrize("background", [True, False])
def test_equal_seeds_give_equal_pictures(background: bool) -> None:
    first, again = (view(4, background).radiance(2, 9) for _ in range(2))
    assert first.shape == (64, 96, 3)
    assert np.isfinite(first).all()
    assert first.mean() > 0
    assert np.array_equal(first, again)
    assert not np.array_equal(first, view(5, background).radiance(2, 9))


def test_walls_are_kept_in_about_half_of_the_rooms() -> None:
    floors = sum(bool(np.any(view(seed, background=False).body_ids == 100)) for seed in range(12))
    assert 2 <= floors <= 10


def test_a_camera_with_other_focal_lengths_is_refused() -> None:
    stretched = CameraIntrinsics(70.0, 71.0, 45.3, 30.8, 96, 64)
    with pytest.raises(ValueError, match="square pixels"):
        PathTracedView(scene(), stretched, X_WORLD_CAMERA, Surroundings(), np.random.default_rng(0))


@pytest.mark.parametrize("color", [(1.0, 0.3, 0.3), (0.3, 1.0, 0.3), (0.3, 0.3, 1.0)])
def test_a_camera_keeps_hue_and_exposes_for_mid_grey(color: tuple[float, float, float]) -> None:
    for brightness in (0.01, 1.0, 100.0):
        light = np.full((32, 48, 3), brightness, np.float32) * np.asarray(color, np.float32)
        picture = PLAIN.picture(light, np.random.default_rng(0))
        assert picture.shape == (32, 48, 3)
        mean = picture.reshape(-1, 3).mean(axis=0)
        assert np.argmax(mean) == np.argmax(color)
        assert 70 < mean.mean() < 150


def test_fewer_electrons_are_noisier() -> None:
    light = np.full((64, 64, 3), 0.5, np.float32)
    spread = []
    for electrons in (1e5, 3e3, 8e2):
        camera = replace(PLAIN, electrons=electrons)
        spread.append(float(camera.picture(light, np.random.default_rng(1)).std()))
    assert spread == sorted(spread)
    assert spread[-1] > 2 * spread[0]
