"""One scene by embree, by Warp's trees on the processor, and on a GPU where there is one: the same image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.depth_noise import DepthNoise
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform
from toolee_robot.render import Body, Light, Material, Mesh, Pattern, Scene, caster, render
from toolee_robot.render.device import checked
from toolee_robot.render.mesh import box, cylinder, plane, sphere
from toolee_robot.render.rays import BvhTracer, Tracer
from toolee_robot.render.renderer import Shot
from toolee_robot.render.scene import Backdrop, Patch, Rendering
from toolee_robot.render.sensor_models import Photo, measure_depth, photograph
from toolee_robot.tools import ToolKind, make_tool
from toolee_robot.types import CameraIntrinsics

K = CameraIntrinsics(220.0, 220.0, 127.0, 105.0, 256, 212)


def scene() -> Scene:
    """A lasting mesh and loose ones, every pattern, a near and a far lamp, a backdrop."""
    tool = make_tool(ToolKind.CLAW_HAMMER, 3)
    hammer = Mesh.build(tool.mesh.vertices, tool.mesh.faces)
    metal = Material((0.7, 0.7, 0.7), (0.3, 0.3, 0.3), Pattern.SCRATCHES, 0.004, 2, 0.3, 1.0, 0.4)
    turned = Rotation.from_euler("xyz", [1.2, 0.4, 0.2])
    bodies = [
        Body(hammer, transform(turned, (0.05, 0.0, 0.6)), metal, 1),
        Body(hammer, transform(turned, (0.03, 0.06, 0.9)), Material(), 2),
        Body(plane(0.8), transform(np.diag([1.0, -1.0, -1.0]), (-0.1, 0.1, 1.4)), Material(pattern=Pattern.PLANKS), 3),
    ]
    for k, pattern in enumerate(Pattern):
        mesh = (box((0.07, 0.05, 0.06)), sphere(0.04, 2), cylinder(0.03, 0.09))[k % 3]
        material = Material(pattern=pattern, scale=0.015, axis=k % 3, wear=0.3, offset=(0.1 * k, 0.0, 0.0))
        bodies.append(Body(mesh, transform(turned, (0.1 * k - 0.4, -0.25, 1.0)), material, 10 + k))
    lights = (
        Light((0.6, 0.6, 0.5), direction=(0.3, -0.6, -0.74), softness=0.05),
        Light((0.2, 0.2, 0.3), position=(0.4, -0.3, 0.2), softness=0.03),
        Light((0.1, 0.1, 0.1), direction=(-0.6, 0.0, -0.8), shadow=False),
    )
    patches = (
        Patch((0.2, 0.2), (0.1, 0.2), 0.4, True, (0.5, 0.1, 0.1)),
        Patch((0.7, 0.6), (0.2, 0.1), 1.0, False, (0.0, 0.5, 0.0)),
    )
    return Scene(bodies, lights, background=Backdrop((0.1, 0.2, 0.3), (0.2, 0.0, 0.0), (0.0, 0.1, 0.2), patches))


def alike(a: Rendering, b: Rendering) -> None:
    """But for single pixels on outlines, where another rounding decides what is hit."""
    assert np.mean(a.body_ids != b.body_ids) < 2e-4
    same = a.body_ids == b.body_ids
    assert np.mean(np.abs(a.depth - b.depth)[same] > 1e-5) < 1e-3
    assert np.mean(np.abs(a.rgb.astype(int) - b.rgb.astype(int)).max(axis=2) > 2) < 5e-3
    assert np.mean(np.abs(a.cos_incidence - b.cos_incidence) > 1e-3) < 1e-3
    np.testing.assert_array_equal(a.shininess[same], b.shininess[same])
    assert len(np.unique(a.body_ids)) > 10
    assert a.rgb.std() > 20


def test_the_trees_that_a_gpu_uses_show_what_embree_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    by_embree = render(scene(), K, np.eye(4), auto_exposure=0.7)

    def tracer_of(meshes: Sequence[tuple[Mesh, Array]], device: str) -> Tracer:
        return BvhTracer(meshes, device)

    monkeypatch.setattr(caster, "tracer_of", tracer_of)
    alike(by_embree, render(scene(), K, np.eye(4), auto_exposure=0.7))


def test_a_region_of_one_body_is_what_a_scene_of_it_alone_shows() -> None:
    whole = scene()
    shot = Shot(whole, K, np.eye(4))
    alone = Shot(Scene([body for body in whole.bodies if body.body_id == 2]), K, np.eye(4)).depth
    region = shot.depth_of(2, (20, 30, 200, 180))
    np.testing.assert_array_equal(region, alone[30:180, 20:200])
    assert 0 < np.count_nonzero(shot.body_ids[30:180, 20:200] == 2) < np.count_nonzero(region)


def test_a_missing_gpu_is_told() -> None:
    with raises(UserError, code="user.device_unknown"):
        checked("vulkan")
    checked("cpu")
    if not wp.is_cuda_available():
        with raises(UserError, code="user.no_gpu"):
            render(scene(), K, np.eye(4), device="cuda")


@pytest.mark.skipif("not __import__('warp').is_cuda_available()", reason="needs a GPU")
def test_a_gpu_shows_what_the_processor_shows() -> None:
    images = [render(scene(), K, np.eye(4), auto_exposure=0.7, device=device) for device in ("cpu", "cuda")]
    alike(*images)
    cpu = images[0]
    surface = (cpu.depth, cpu.cos_incidence, cpu.shininess)
    depths = [measure_depth(*surface, K, DepthNoise(), np.random.default_rng(1), device) for device in ("cpu", "cuda")]
    assert np.mean(np.abs(depths[0] - depths[1]) > 1.5e-3) < 1e-3
    photo = Photo(blur=0.9, motion=3.0, motion_angle=0.5)
    photos = [photograph(cpu.rgb, photo, np.random.default_rng(1), device) for device in ("cpu", "cuda")]
    assert np.abs(photos[0].astype(int) - photos[1].astype(int)).max() <= 1
