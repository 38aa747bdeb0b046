"""Packets of rays against triangle by triangle arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from toolee_robot.frames import Array
from toolee_robot.render.embree import Tracer
from toolee_robot.render.filters import gaussian, neighbours, white


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


@pytest.mark.parametrize("rays", [1, 15, 16, 1000])
def test_each_ray_finds_what_arithmetic_finds(rays: int) -> None:
    rng = np.random.default_rng(rays)
    meshes = [
        (rng.normal((0, 0, 2), 0.5, (20, 3)).astype(np.float32), rng.integers(0, 20, (n, 3), dtype=np.int32))
        for n in (30, 1, 12)
    ]
    corners = np.concatenate([v[f] for v, f in meshes]).astype(np.float64)
    starts = np.cumsum([0, *(len(f) for _, f in meshes)])[:-1]
    tracer = Tracer(meshes)
    directions = np.ones((3, rays), np.float32)
    directions[:2] = rng.uniform(-0.4, 0.4, (2, rays))
    found = tracer.closest(directions)
    with np.errstate(all="ignore"):  # faces may repeat a vertex: no area
        far = np.stack([met(np.zeros(3), d, corners) for d in directions.T.astype(np.float64)])
    hit = np.isfinite(far.min(axis=1))
    np.testing.assert_array_equal(found.mesh >= 0, hit)
    # Of faces that coincide any may be named.
    named = starts[found.mesh] + found.face
    np.testing.assert_allclose(far[hit, named[hit]], far.min(axis=1)[hit], rtol=1e-6)
    np.testing.assert_allclose(found.distance[hit], far.min(axis=1)[hit], rtol=1e-4)
    a, b, c = corners[np.where(hit, named, 0)].transpose(1, 2, 0)
    points = a + found.u * (b - a) + found.v * (c - a)
    np.testing.assert_allclose(points[:, hit], (directions * found.distance)[:, hit], atol=1e-3)

    origins = rng.normal(0.0, 0.1, (3, rays)).astype(np.float32)
    reach = rng.uniform(1.0, 3.0, rays).astype(np.float32)
    with np.errstate(all="ignore"):
        pairs = zip(origins.T.astype(np.float64), directions.T.astype(np.float64), strict=True)
        first = np.array([met(o, d, corners).min() for o, d in pairs])
    clear = np.abs(first - reach) > 1e-3
    np.testing.assert_array_equal(tracer.blocked(origins, directions, reach)[clear], (first < reach)[clear])


def test_nothing_to_hit() -> None:
    tracer = Tracer([])
    directions = np.ones((3, 5), np.float32)
    assert np.all(tracer.closest(directions).mesh == -1)
    assert not tracer.blocked(directions, directions, np.ones(5, np.float32)).any()


def test_filters_do_what_they_are_called_for() -> None:
    rng = np.random.default_rng(0)
    marks = (rng.random((23, 31)) < 0.4).astype(np.uint8)
    padded = np.pad(marks, 2).astype(int)
    count = sum(padded[i : i + 23, j : j + 31] for i in range(5) for j in range(5))
    np.testing.assert_array_equal(neighbours(marks, 2), count)

    point = np.zeros((2, 41, 41), np.float32)
    point[1, 20, 20] = 1.0
    blurred = gaussian(point, 2.0)
    offset = np.arange(41) - 20
    expected = np.exp(-(offset[:, None] ** 2 + offset**2) / 8.0) / (8.0 * np.pi)
    assert not blurred[0].any()
    np.testing.assert_allclose(blurred[1], expected, atol=4e-4)

    numbers = white(np.random.default_rng(1), (3, 201, 333))
    assert numbers.shape == (3, 201, 333)
    assert abs(float(numbers.mean())) < 0.01
    assert float(numbers.std()) == pytest.approx(1.0, abs=0.01)
    assert float(np.mean(np.abs(numbers) > 2.0)) == pytest.approx(0.0455, abs=0.002)
    assert float(np.mean(np.abs(numbers) > 3.0)) == pytest.approx(0.0027, abs=0.0005)
    assert abs(float(np.corrcoef(numbers.reshape(-1)[:100000], numbers.reshape(-1)[-100000:])[0, 1])) < 0.02
