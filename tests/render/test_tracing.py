"""Rays against triangle by triangle arithmetic, by embree and by Warp's trees; and the filters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.render.device import DeviceArray, checked, put
from toolee_robot.render.mesh import FloatArray, Mesh
from toolee_robot.render.rays import BvhTracer, EmbreeTracer, Tracer, in_camera
from toolee_robot.render.sensor_models import gaussian, white

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


@pytest.mark.parametrize("tracer_of", [embree, warp_tree])
def test_nothing_to_hit(tracer_of: Callable[[Meshes], Tracer]) -> None:
    tracer = tracer_of([])
    directions = rows(np.ones((3, 5), np.float32))
    assert np.all(tracer.closest(directions).ids.numpy()[1] == -1)
    assert not tracer.blocked(directions, directions, rows(np.ones(5, np.float32))).numpy().any()


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
