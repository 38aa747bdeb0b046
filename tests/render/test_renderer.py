"""Depth, ids and the pixel convention against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.render import Body, Light, Material, Mesh, Pattern, Scene, render
from toolee_robot.render.mesh import box, cylinder, plane, sphere
from toolee_robot.render.renderer import Shot, pixel_rays
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


def test_depth_of_a_sphere() -> None:
    X_world_camera = somewhere()
    centre, radius = np.array([0.05, -0.1, 0.8]), 0.15
    body = Body(sphere(radius, 6), X_world_camera @ transform(p=centre))
    depth = Shot(Scene([body]), K, X_world_camera).depth
    rays = pixel_rays(K).astype(np.float64)
    a, b = (rays**2).sum(-1), rays @ centre
    root = b**2 - a * (centre @ centre - radius**2)
    inside = root > (0.2 * radius) ** 2 * a  # the outline of a polyhedron is not the sphere's
    expected = (b - np.sqrt(np.maximum(root, 0))) / a
    assert inside.sum() > 5000
    np.testing.assert_allclose(depth[inside], expected[inside], atol=1e-4)


def test_a_known_point_appears_at_its_pixel() -> None:
    p = np.array([0.21, -0.13, 0.7])
    small = Body(sphere(0.002, 2), transform(p=p), body_id=7)
    ids = Shot(Scene([small]), K, np.eye(4)).body_ids
    rows, columns = np.nonzero(ids == 7)
    u, v = K.fx * p[0] / p[2] + K.cx, K.fy * p[1] / p[2] + K.cy
    assert abs(columns.mean() - u) < 0.3
    assert abs(rows.mean() - v) < 0.3


def test_the_nearer_body_wins_and_keeps_its_id() -> None:
    far = Body(plane(4.0), transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 1.0)), body_id=3)
    near = Body(box((0.2, 0.2, 0.1)), transform(p=(0, 0, 0.6)), body_id=9)
    image = render(Scene([far, near]), SMALL, np.eye(4))
    assert image.body_ids[52, 63] == 9
    assert image.depth[52, 63] == pytest.approx(0.55, abs=1e-5)
    assert image.body_ids[2, 2] == 3
    assert image.cos_incidence[52, 63] == pytest.approx(1.0, abs=1e-3)


def test_nothing_hit_is_marked() -> None:
    image = render(Scene([]), SMALL, np.eye(4))
    assert np.all(image.body_ids == -1)
    assert np.all(image.depth == 0)


def test_shadow_falls_where_the_lamp_is_hidden() -> None:
    floor = Body(plane(4.0), np.eye(4), Material((0.5, 0.5, 0.5)), 0)
    block = Body(box((0.2, 0.2, 0.02)), transform(p=(0.0, 0.0, 0.3)), body_id=1)
    lamp = Light((2.0, 2.0, 2.0), direction=(0.6, 0.0, 0.8), softness=0.0)
    X_world_camera = transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 1.5))
    image = render(Scene([floor, block], [lamp]), K, X_world_camera, antialias=False)
    x = -0.3 * 0.6 / 0.8  # where the block's centre throws its shadow
    column, row = round(K.fx * x / 1.5 + K.cx), round(K.cy)
    mirrored = round(-K.fx * x / 1.5 + K.cx)
    assert image.body_ids[row, column] == 0
    assert int(image.rgb[row, column].sum()) < 0.8 * int(image.rgb[row, mirrored].sum())


def test_equal_calls_give_equal_bytes() -> None:
    bodies = [
        Body(cylinder(0.05, 0.2), transform(Rotation.from_euler("x", 0.3 * k), (0.1 * k - 0.4, 0, 0.8)),
             Material(pattern=pattern, metallic=0.5, wear=0.3), k)
        for k, pattern in enumerate(Pattern)
    ]  # fmt: skip
    scene = Scene(bodies, [Light((1, 1, 1), position=(0.3, -0.5, 0.0))])
    a, b = render(scene, SMALL, np.eye(4)), render(scene, SMALL, np.eye(4))
    assert np.array_equal(a.rgb, b.rgb)
    assert np.array_equal(a.depth, b.depth)
    assert a.rgb.std() > 10


def test_mirrored_mesh_keeps_its_outside_outside() -> None:
    mesh = Mesh.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    mirrored = mesh.mirrored()
    a, b, c = mirrored.vertices[mirrored.faces[0]]
    np.testing.assert_allclose(np.cross(b - a, c - a), [0, 0, 1])
    np.testing.assert_allclose(mirrored.corner_normals[0], [[0, 0, 1]] * 3)


def test_normals_are_smooth_on_a_round_side_and_sharp_at_its_rim() -> None:
    mesh = cylinder(1.0, 2.0, 48)
    corners = mesh.vertices[mesh.faces]
    side = np.abs(corners[..., 2]).min(axis=1) == 1.0
    radial = corners[..., :2] / np.maximum(np.linalg.norm(corners[..., :2], axis=-1, keepdims=True), 1e-9)
    on_side = side & (np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]) < 1e-6)
    dots = np.einsum("fci,fci->fc", mesh.corner_normals[on_side][..., :2], radial[on_side])
    assert dots.min() > 0.999
    caps = ~on_side
    assert np.abs(mesh.corner_normals[caps][..., 2]).min() > 0.999
