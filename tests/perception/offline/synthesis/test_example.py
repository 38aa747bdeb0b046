"""The synthetic data set: what its masks and poses promise, and that its bytes depend on the seed alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.errors import AssetError
from toolee_robot.frames import Array
from toolee_robot.perception.offline.dataset.catalogue import GENERATED, number_of
from toolee_robot.perception.offline.dataset.records import (
    CIRCLE,
    FOCAL,
    MAX_EES,
    Example,
    draw,
)
from toolee_robot.perception.offline.dataset.scenes import load, write_scene
from toolee_robot.perception.offline.synthesis.clutter import Surfaces
from toolee_robot.perception.offline.synthesis.example import Series, label, make_example, render_example
from toolee_robot.perception.offline.synthesis.station import DEPTHS
from toolee_robot.render.renderer import pixel_rays
from toolee_robot.types import CameraIntrinsics

pytestmark = pytest.mark.sim


def back_project(depth: Array, intrinsics: CameraIntrinsics) -> Array:
    """(H, W, 3) points [m], camera frame."""
    return np.asarray(pixel_rays(intrinsics) * depth[..., None], dtype=np.float64)


@pytest.fixture(scope="module")
def examples() -> list[Example]:
    return [make_example(Series(5), i) for i in range(9)]


def test_ee_masks_are_the_tools_pixels_within_the_sphere() -> None:
    checked = 0
    for index in range(4):
        taken = render_example(Series(5), index)
        sample, depth = taken.sample, taken.shot.depth
        ee, tool, full, table = label(sample, taken.shot)
        points = back_project(depth.astype(np.float64), sample.intrinsics)
        assert not np.any((ee > 0) & (tool == 0))
        near_some_ee = np.zeros(ee.shape, bool)
        for row in np.flatnonzero(table.category):
            mask = ee == row + 1
            assert mask.sum() == table.visible[row]
            alone = (full >> row) & 1 > 0
            assert alone.sum() == table.unoccluded[row]
            assert not np.any(mask & ~alone)
            assert table.visible[row] <= table.unoccluded[row]
            assert np.all(tool[mask] == table.tool[row])
            distance = np.linalg.norm(points - table.X_camera_ee[row, :3, 3], axis=-1)
            radius = CATEGORIES[table.category[row] - 1].spec.radius
            assert np.all(distance[mask] < radius + 1e-4)
            near_some_ee |= (distance < radius - 1e-4) & (tool == table.tool[row])
            checked += bool(mask.any())
        assert np.all(ee[near_some_ee] > 0)
    assert checked >= 3


def test_surfaces_of_the_splits_are_disjoint() -> None:
    rng = np.random.default_rng(0)
    train, test = ({draw(rng, split, 1000) for _ in range(4000)} for split in ("train", "test"))
    assert len(train) > 700
    assert len(test) == 200
    assert not train & test
    rooms = [{Surfaces(split).room(rng) for _ in range(300)} for split in ("train", "test")]
    assert not rooms[0] & rooms[1]


def test_the_papers_protocol() -> None:
    """Upright tool, no roll, one grasp, exact depth, a circle of pixels; held-out tools only in the test split."""
    grips = []
    for index in range(3):
        taken = render_example(Series(6, "test", "paper"), index)
        sample, table = taken.sample, taken.labels[3]
        (placed,) = sample.tools
        assert GENERATED.split(number_of(placed.tool)) == "test"
        np.testing.assert_allclose(placed.X_world_tool[:3, 2], [0, 0, 1], atol=1e-12)
        assert abs(sample.X_world_camera[2, 0]) < 1e-12, "the image's rows are level"
        assert sample.intrinsics.fx == FOCAL
        e = make_example(Series(6, "test", "paper"), index)
        assert np.array_equal(e.depth_mm, (taken.shot.depth * np.float32(1000) + np.float32(0.5)).astype(np.uint16))
        rows, columns = np.nonzero(e.ee)
        assert len(rows) >= 50
        reaches = []
        for row in np.flatnonzero(table.category):
            x, y, z = table.X_camera_ee[row, :3, 3]
            u, v = FOCAL * x / z + sample.intrinsics.cx, FOCAL * y / z + sample.intrinsics.cy
            reaches.append(np.hypot(columns - u, rows - v))
        assert np.min(reaches, axis=0).max() <= CIRCLE + 1e-3
        assert any(DEPTHS[0] - 1e-6 <= d <= DEPTHS[1] + 1e-6 for d in table.X_camera_ee[table.category > 0][:, 2, 3])
        assert placed.X_world_hand is not None
        grips.append(np.linalg.inv(placed.X_world_hand) @ placed.X_world_tool)
        assert not placed.mirrored
    for X in grips:
        np.testing.assert_allclose(X[:3, :3], grips[0][:3, :3], atol=1e-9)


def test_stored_and_loaded(tmp_path: Path, examples: list[Example]) -> None:
    write_scene(tmp_path / "000000", examples)
    data = load(tmp_path)
    assert len(data) == len(examples)
    assert data.categories.shape == (len(examples), MAX_EES)
    for i, e in enumerate(examples):
        assert np.array_equal(data.ee[i], e.ee)
        assert np.array_equal(data.tool[i], e.tool)
        assert data.depth_mm is not None
        assert np.array_equal(data.depth_mm[i], e.depth_mm)
        assert np.abs(data.rgb[i].astype(int) - e.rgb).mean() < 4.0
        for field in dataclasses.fields(e.table):
            np.testing.assert_array_equal(getattr(data.row(i), field.name), getattr(e.table, field.name))
        assert data.camera(i) == e.intrinsics
    assert len(load(tmp_path, limit=5)) == 5


def test_misuse_says_what_to_do(tmp_path: Path, examples: list[Example]) -> None:
    with raises(AssetError, code="asset.no_scene"):
        load(tmp_path)
    write_scene(tmp_path / "000000", examples[:2])
    (tmp_path / "000000/rgb/000001.jpg").write_bytes(b"not an image")
    with pytest.raises(AssetError, match=r"000001\.jpg"):
        load(tmp_path)
