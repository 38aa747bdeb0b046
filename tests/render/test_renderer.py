"""Depth, ids and the pixel convention against closed forms."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
import warp as wp
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.depth_noise import DepthNoise
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.render import Body, Light, Material, Mesh, Pattern, Scene, caster, render
from toolee_robot.render.depth_sensors import Photo, gaussian, measure_depth, photograph, white
from toolee_robot.render.device import DeviceArray, checked, put
from toolee_robot.render.material import Backdrop, Patch, Rendering
from toolee_robot.render.mesh import FloatArray, box, cylinder, plane, sphere
from toolee_robot.render.rays import BvhTracer, EmbreeTracer, Tracer, in_camera
from toolee_robot.render.renderer import Shot, pixel_rays
from toolee_robot.tools import ToolKind, make_tool
from toolee_robot.types import CameraIntrinsics

K = CameraIntrinsics(365.5, 360.0, 254.9, 205.4, 512, 424)
SMALL = CameraIntrinsics(90.0, 90.0, 63.5, 52.5, 128, 106)


def somewhere() -> Array:
    """X_world_camera far from the origin, at no special angle."""
    return transform(Rotation.from_euler("xyz", [0.4, -1.1, 2.0]), (3.0, -2.0, 1.5))


def test_depth_of_a_tilted_plane_is_exact() -> None:
    X_world_camera = somewhere()
    X_camera_plane = transform(Rotation.from_euler("xy", [np.pi - 0.5, 0.3]), (0.1, -0.05, 0.9))
    depth = Shot(Scene([Body(plane(20.0), X_world_camera @ X_camera_plane)]), K, X_world_camera).depth
    rays = pixel_rays(K).astype(np.float64)
    n, p = X_camera_plane[:3, 2], X_camera_plane[:3, 3]
    expected = (n @ p) / (rays @ n)
    hit = depth > 0
    assert hit.mean() > 0.9
    np.testing.assert_allclose(depth[hit], expected[hit], atol=1e-4 * expected[hit].max())


Meshes = list[tuple[Mesh, Array]]


def met(origin: Array, direction: Array, corners: Array) -> Array:
    """(T,) how far along the ray each of the triangles (T, 3, 3) is met, infinite if it is not (Moeller, Trumbore)."""
    a, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, c)
    det = np.einsum("ij,ij->i", b, p)
    s = origin - a
    u = np.einsum("ij,ij->i", s, p) / det
    q = np.cross(s, b)
    v = q @ direction / det
    t = np.einsum("ij,ij->i", c, q) / det
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)


def embree(meshes: Meshes) -> Tracer:
    return EmbreeTracer(meshes)


def warp_tree(meshes: Meshes) -> Tracer:
    return BvhTracer(meshes, checked("cpu"))


def rows(values: FloatArray) -> DeviceArray:
    return put(values, wp.float32, checked("cpu"))


@pytest.mark.parametrize("tracer_of", [embree, warp_tree])
@pytest.mark.parametrize("rays", [1, 15, 16, 1000])
def test_each_ray_finds_what_arithmetic_finds(rays: int, tracer_of: Callable[[Meshes], Tracer]) -> None:
    rng = np.random.default_rng(rays)
    meshes = []
    for count, lasting in ((30, True), (1, False), (12, False), (25, True)):
        X_camera_body = transform(Rotation.random(rng=rng), rng.normal(0.0, 3.0, 3))
        vertices = transform_points(inverse(X_camera_body), rng.normal((0, 0, 2), 0.5, (20, 3))).astype(np.float32)
        faces = rng.integers(0, 20, (count, 3), dtype=np.int32)
        meshes.append((Mesh(vertices, faces, np.zeros((count, 3, 3), np.float32), lasting), X_camera_body))
    corners = np.concatenate([in_camera(mesh, X)[mesh.faces] for mesh, X in meshes]).astype(np.float64)
    starts = np.cumsum([0, *(len(mesh.faces) for mesh, _ in meshes)])[:-1]
    tracer = tracer_of(meshes)
    directions = np.ones((3, rays), np.float32)
    directions[:2] = rng.uniform(-0.4, 0.4, (2, rays))
    found = tracer.closest(rows(directions))
    (distance, *_, u, v), (face, mesh) = found.values.numpy(), found.ids.numpy()
    with np.errstate(all="ignore"):  # faces may repeat a vertex: no area
        far = np.stack([met(np.zeros(3), d, corners) for d in directions.T.astype(np.float64)])
    hit = np.isfinite(far.min(axis=1))
    np.testing.assert_array_equal(mesh >= 0, hit)
    # Of faces that coincide any may be named.
    named = np.where(hit, starts[mesh] + face, 0)
    np.testing.assert_allclose(far[hit, named[hit]], far.min(axis=1)[hit], rtol=1e-6)
    np.testing.assert_allclose(distance[hit], far.min(axis=1)[hit], rtol=1e-4)
    a, b, c = corners[named].transpose(1, 2, 0)
    points = a + u * (b - a) + v * (c - a)
    np.testing.assert_allclose(points[:, hit], (directions * distance)[:, hit], atol=1e-3)
    normals = np.cross((b - a).T, (c - a).T)[hit]
    slant = np.abs(np.einsum("ni,in->n", normals, found.values.numpy()[1:4, hit]))
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(found.values.numpy()[1:4, hit], axis=0)
    np.testing.assert_allclose(slant, lengths, rtol=1e-3)

    origins = rng.normal(0.0, 0.1, (3, rays)).astype(np.float32)
    reach = rng.uniform(1.0, 3.0, rays).astype(np.float32)
    with np.errstate(all="ignore"):
        pairs = zip(origins.T.astype(np.float64), directions.T.astype(np.float64), strict=True)
        first = np.array([met(o, d, corners).min() for o, d in pairs])
    clear = np.abs(first - reach) > 1e-3
    blocked = tracer.blocked(rows(origins), rows(directions), rows(reach)).numpy()
    np.testing.assert_array_equal(blocked[clear] > 0, (first < reach)[clear])


def test_filters_do_what_they_are_called_for() -> None:
    point = np.zeros((2, 41, 43), np.float32)
    point[1, 20, 20] = 1.0
    blurred = gaussian(rows(point), 2.0, "cpu", 3.0).numpy()
    down, right = np.arange(41)[:, None] - 20, np.arange(43) - 20
    expected = 3.0 * np.exp(-(down**2 + right**2) / 8.0) / (8.0 * np.pi)
    assert not blurred[0].any()
    np.testing.assert_allclose(blurred[1], expected, atol=1.2e-3)
    # At the border as scipy has it, which calls this "mirror".
    image = np.random.default_rng(0).random((1, 9, 12)).astype(np.float32)
    np.testing.assert_allclose(
        gaussian(rows(image), 1.0, "cpu").numpy()[0],
        gaussian_filter(image[0], 1.0, mode="mirror", radius=3),
        atol=1e-6,
    )

    numbers = white(1, (3, 201, 333), checked("cpu")).numpy()
    assert abs(float(numbers.mean())) < 0.01
    assert float(numbers.std()) == pytest.approx(1.0, abs=0.01)
    assert float(np.mean(np.abs(numbers) > 2.0)) == pytest.approx(0.0455, abs=0.002)
    assert float(np.mean(np.abs(numbers) > 3.0)) == pytest.approx(0.0027, abs=0.0005)
    flat = numbers.reshape(-1)
    for lag in (1, 2, 333, len(flat) // 2):
        assert abs(float(np.corrcoef(flat[:-lag], flat[lag:])[0, 1])) < 0.01
    assert abs(float(np.corrcoef(flat, white(2, (3, 201, 333), "cpu").numpy().reshape(-1))[0, 1])) < 0.01


K_DEVICES = CameraIntrinsics(220.0, 220.0, 127.0, 105.0, 256, 212)


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
    by_embree = render(scene(), K_DEVICES, np.eye(4), auto_exposure=0.7)

    def tracer_of(meshes: Sequence[tuple[Mesh, Array]], device: str) -> Tracer:
        return BvhTracer(meshes, device)

    monkeypatch.setattr(caster, "tracer_of", tracer_of)
    alike(by_embree, render(scene(), K_DEVICES, np.eye(4), auto_exposure=0.7))


def test_a_region_of_one_body_is_what_a_scene_of_it_alone_shows() -> None:
    whole = scene()
    shot = Shot(whole, K_DEVICES, np.eye(4))
    alone = Shot(Scene([body for body in whole.bodies if body.body_id == 2]), K_DEVICES, np.eye(4)).depth
    region = shot.depth_of(2, (20, 30, 200, 180))
    np.testing.assert_array_equal(region, alone[30:180, 20:200])
    assert 0 < np.count_nonzero(shot.body_ids[30:180, 20:200] == 2) < np.count_nonzero(region)


def test_a_missing_gpu_is_told() -> None:
    with raises(UserError, says="choose cpu or cuda"):
        checked("vulkan")
    checked("cpu")
    if not wp.is_cuda_available():
        with raises(UserError, says="Warp finds no NVIDIA GPU, or"):
            render(scene(), K_DEVICES, np.eye(4), device="cuda")


@pytest.mark.skipif("not __import__('warp').is_cuda_available()", reason="needs a GPU")
def test_a_gpu_shows_what_the_processor_shows() -> None:
    images = [render(scene(), K_DEVICES, np.eye(4), auto_exposure=0.7, device=device) for device in ("cpu", "cuda")]
    alike(*images)
    cpu = images[0]
    surface = (cpu.depth, cpu.cos_incidence, cpu.shininess)
    depths = [
        measure_depth(*surface, K_DEVICES, DepthNoise(), np.random.default_rng(1), device) for device in ("cpu", "cuda")
    ]
    assert np.mean(np.abs(depths[0] - depths[1]) > 1.5e-3) < 1e-3
    photo = Photo(blur=0.9, motion=3.0, motion_angle=0.5)
    photos = [photograph(cpu.rgb, photo, np.random.default_rng(1), device) for device in ("cpu", "cuda")]
    assert np.abs(photos[0].astype(int) - photos[1].astype(int)).max() <= 1
