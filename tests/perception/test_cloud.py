"""Clouds of known surfaces, and depth in the wrong unit."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from toolee_robot.end_effectors import Category
from toolee_robot.perception.cloud import (
    back_project,
    check_depth_unit,
    ee_cloud,
    trim,
    without_flying_pixels,
)
from toolee_robot.perception.pose.canonical import MIN_POINTS, REST_MIN
from toolee_robot.types import CameraIntrinsics, Detection, RgbdFrame

CAMERA = CameraIntrinsics(365.5, 365.5, 254.9, 205.4, 512, 424)


def plane_depth(normal: np.ndarray, distance: float) -> np.ndarray:
    """Depth of the plane n.p = distance seen by CAMERA."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    return distance / (rays @ normal)


def frame(depth: np.ndarray) -> RgbdFrame:
    return RgbdFrame(np.zeros((424, 512, 3), np.uint8), depth.astype(np.float32), CAMERA)


def detection(mask: np.ndarray, tool: np.ndarray | None = None) -> Detection:
    return Detection(Category.HAMMER_HEAD, 0.9, mask, (0, 0, 1, 1), tool)


def disc(row: int, column: int, radius: int) -> np.ndarray:
    v, u = np.mgrid[:424, :512]
    return (v - row) ** 2 + (u - column) ** 2 <= radius**2


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.4, 2.0))
def test_a_known_plane_comes_back_exactly(a: float, b: float, distance: float) -> None:
    normal = np.array([a, b, 1.0]) / np.linalg.norm([a, b, 1.0])
    points = back_project(plane_depth(normal, distance), disc(200, 250, 30), CAMERA)
    assert len(points) == disc(200, 250, 30).sum()
    np.testing.assert_allclose(points @ normal, distance, atol=1e-9)
    u = points[:, 0] / points[:, 2] * CAMERA.fx + CAMERA.cx
    np.testing.assert_allclose(u, np.round(u), atol=1e-6)


def test_unknown_depth_gives_no_points() -> None:
    depth = np.full((424, 512), 0.8)
    mask = disc(200, 250, 10)
    depth[200, 250], depth[201, 250], depth[202, 250], depth[203, 250] = 0.0, np.nan, np.inf, -1.0
    points = back_project(depth, mask, CAMERA)
    assert len(points) == mask.sum() - 4
    assert np.isfinite(points).all()


def test_depth_in_metres_or_unknown_passes() -> None:
    check_depth_unit(np.full((4, 4), 0.8))
    check_depth_unit(np.array([[np.nan, 0.0], [np.nan, 0.9]]))
    check_depth_unit(np.zeros((4, 4)))


def test_flying_pixels_between_two_surfaces_go_and_the_surfaces_stay() -> None:
    depth = np.full((424, 512), 1.5)
    tool = disc(200, 250, 20)
    depth[tool] = 0.8
    rim = tool & ~disc(200, 250, 19)
    rng = np.random.default_rng(0)
    depth[rim] = rng.uniform(0.9, 1.4, int(rim.sum()))
    kept = without_flying_pixels(depth, tool)
    assert kept[disc(200, 250, 18)].all()
    assert kept[rim].mean() < 0.25


def test_the_cloud_of_a_thin_tool_is_not_its_background() -> None:
    """A dilated mask on a thin shaft holds more background than shaft."""
    depth = np.full((424, 512), 1.6)
    depth[150:210, 247:253] = 0.7
    mask = np.zeros((424, 512), bool)
    mask[145:215, 240:260] = True
    cloud = ee_cloud(frame(depth), Detection(Category.SCREWDRIVER_HEAD, 0.9, mask, (0, 0, 1, 1)))
    assert cloud.usable
    assert len(cloud.points) >= 300
    np.testing.assert_allclose(cloud.points[:, 2], 0.7, atol=0.01)


def test_trim_keeps_a_compact_cloud_whole() -> None:
    points = np.random.default_rng(0).normal([0.1, 0.0, 0.8], 0.012, (500, 3))
    assert len(trim(points, 0.09)) == 500
    assert len(trim(np.empty((0, 3)), 0.09)) == 0


def test_pixels_without_a_depth_are_completed_from_their_neighbours() -> None:
    """A steel face that loses its rim and some of its middle is whole again; the wall behind it is not the tool."""
    depth = np.full((424, 512), 1.5)
    face = disc(200, 250, 12)
    depth[face] = 0.6
    lost = face & ~disc(200, 250, 10) | disc(196, 250, 1)
    depth[lost] = 0.0
    cloud = ee_cloud(frame(depth), detection(face))
    assert len(cloud.completed) == lost.sum()
    np.testing.assert_allclose(cloud.completed[:, 2], 0.6, atol=1e-6)
    radius = np.hypot(*(cloud.completed[:, :2] - cloud.points[:, :2].mean(axis=0)).T)
    assert radius.max() > 1.1 * np.hypot(*(cloud.points[:, :2] - cloud.points[:, :2].mean(axis=0)).T).max()
    whole = ee_cloud(frame(np.where(lost, 0.6, depth)), detection(disc(200, 250, 8)))
    assert len(whole.completed) == 0


def test_what_a_wide_mask_holds_of_the_wall_is_not_completed_as_the_tool() -> None:
    depth = np.full((424, 512), 1.6)
    depth[150:210, 240:260] = 0.7
    depth[150:210, 258:260] = np.nan
    depth[150:210, 268:270] = np.nan
    mask = np.zeros((424, 512), bool)
    mask[145:215, 230:270] = True
    cloud = ee_cloud(frame(depth), detection(mask))
    # The column at the tool's edge; the one at the wall's is the wall's.
    assert 60 <= len(cloud.completed) <= 62
    np.testing.assert_allclose(cloud.completed[:, 2], 0.7, atol=0.01)


def test_too_few_points_give_a_reason_instead_of_a_cloud() -> None:
    depth = np.zeros((424, 512))
    depth[200:204, 250:255] = 0.8
    cloud = ee_cloud(frame(depth), detection(disc(202, 252, 10)))
    assert not cloud.usable
    assert str(MIN_POINTS) in cloud.reason
    assert len(cloud.points) == 0


def test_the_rest_of_the_tool_is_kept() -> None:
    depth = np.full((424, 512), 1.5)
    head, handle = disc(200, 150, 12), np.zeros((424, 512), bool)
    handle[195:205, 162:300] = True
    depth[head | handle] = 0.8
    with_tool = ee_cloud(frame(depth), detection(head, head | handle))
    assert len(with_tool.rest) > 1000
    assert (with_tool.rest[:, 0] > with_tool.points[:, 0].mean()).all()
    assert len(ee_cloud(frame(depth), detection(head)).rest) == 0
    assert len(ee_cloud(frame(depth), detection(head, head)).rest) < REST_MIN
