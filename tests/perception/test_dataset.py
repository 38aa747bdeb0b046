"""The synthetic data set: what its masks and poses promise, and that its bytes depend on the seed alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from toolee_robot.errors import AssetError, UserError
from toolee_robot.frames import Array, is_rigid
from toolee_robot.perception.dataset.example import label, make_example, make_scene
from toolee_robot.perception.dataset.generate import generate
from toolee_robot.perception.dataset.inspect import montage
from toolee_robot.perception.dataset.records import CATEGORIES, MAX_EES, Example
from toolee_robot.perception.dataset.storage import load, write_shard
from toolee_robot.render.renderer import cast, pixel_rays
from toolee_robot.tools import ToolKind, ee_radius, make_tool, split
from toolee_robot.types import CameraIntrinsics


def back_project(depth: Array, intrinsics: CameraIntrinsics) -> Array:
    """(H, W, 3) points [m], camera frame."""
    return np.asarray(pixel_rays(intrinsics) * depth[..., None], dtype=np.float64)


@pytest.fixture(scope="module")
def examples() -> list[Example]:
    return [make_example(5, i) for i in range(9)]


def test_examples_cover_scenes_and_show_tools(examples: list[Example]) -> None:
    assert {e.scene for e in examples} >= {0, 1}
    assert sum(bool(np.any(e.table.visible >= 50)) for e in examples) >= 5
    assert any(np.all(np.isfinite(e.table.X_camera_hand[0])) for e in examples)


def test_ee_masks_are_the_tools_pixels_within_the_sphere() -> None:
    checked = 0
    for index in range(4):
        sample, _ = make_scene(5, index)
        depth, ids = cast(sample.scene.bodies, sample.intrinsics, sample.X_world_camera)
        ee, tool, table = label(sample, depth, ids)
        points = back_project(depth.astype(np.float64), sample.intrinsics)
        assert not np.any((ee > 0) & (tool == 0))
        near_some_ee = np.zeros(ee.shape, bool)
        for row in np.flatnonzero(table.category):
            mask = ee == row + 1
            assert mask.sum() == table.visible[row]
            assert table.visible[row] <= table.unoccluded[row]
            assert np.all(tool[mask] == table.tool[row])
            distance = np.linalg.norm(points - table.X_camera_ee[row, :3, 3], axis=-1)
            radius = ee_radius(CATEGORIES[table.category[row] - 1])
            assert np.all(distance[mask] < radius + 1e-4)
            near_some_ee |= (distance < radius - 1e-4) & (tool == table.tool[row])
            checked += bool(mask.any())
        assert np.all(ee[near_some_ee] > 0)
    assert checked >= 3


def test_noisy_depth_stays_on_the_labelled_tool(examples: list[Example]) -> None:
    for e in examples:
        points = back_project(e.depth_mm.astype(np.float64) * 1e-3, e.intrinsics)
        for row in np.flatnonzero(e.table.visible > 400):
            seen = (e.ee == row + 1) & (e.depth_mm > 0)
            distance = np.linalg.norm(points[seen] - e.table.X_camera_ee[row, :3, 3], axis=1)
            radius = ee_radius(CATEGORIES[e.table.category[row] - 1])
            assert np.median(distance) < radius + 0.005


def test_poses_agree_with_the_tools(examples: list[Example]) -> None:
    for e in examples:
        for row in np.flatnonzero(e.table.category):
            tool = make_tool(tuple(ToolKind)[e.table.kind[row]], int(e.table.seed[row]))
            assert split(tool.seed) == "train"
            X_camera_tool = e.table.X_camera_tool[row].astype(np.float64)
            assert is_rigid(X_camera_tool, 1e-5)
            X = np.linalg.inv(X_camera_tool) @ e.table.X_camera_ee[row]
            category = CATEGORIES[e.table.category[row] - 1]
            assert any(ee.category == category and np.allclose(ee.X_tool_ee, X, atol=1e-5) for ee in tool.ees)
            if np.all(np.isfinite(e.table.X_camera_hand[row])):
                grip = (np.linalg.inv(e.table.X_camera_hand[row]) @ X_camera_tool)[:3, 3]
                assert np.linalg.norm(grip) < 0.16  # the handle runs through the palm


def test_held_out_tools_only_in_the_test_split() -> None:
    e = make_example(5, 1, "test")
    rows = np.flatnonzero(e.table.category)
    assert all(split(int(seed)) == "test" for seed in e.table.seed[rows])


def test_same_bytes_for_any_number_of_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    one, two = tmp_path / "one", tmp_path / "two"
    generate(one, size=3, seed=3, workers=1, start=64)
    generate(two, size=3, seed=3, workers=2, start=64)
    names = sorted(p.name for p in one.iterdir())
    assert names == ["dataset.json", "shard-00001.npz"]
    assert names == sorted(p.name for p in two.iterdir())
    for name in names:
        assert (one / name).read_bytes() == (two / name).read_bytes()


def test_stored_and_loaded(tmp_path: Path, examples: list[Example]) -> None:
    write_shard(tmp_path / "shard-00000.npz", examples)
    data = load(tmp_path, depth=True)
    assert len(data) == len(examples)
    assert data.categories.shape == (len(examples), MAX_EES)
    for i, e in enumerate(examples):
        assert np.array_equal(data.ee[i], e.ee)
        assert np.array_equal(data.tool[i], e.tool)
        assert data.depth_mm is not None
        assert np.array_equal(data.depth_mm[i], e.depth_mm)
        assert np.abs(data.rgb[i].astype(int) - e.rgb).mean() < 4.0
        for field in dataclasses.fields(e.table):
            np.testing.assert_array_equal(getattr(data.table, field.name)[i], getattr(e.table, field.name))
        assert data.example(i).intrinsics == e.intrinsics
    assert len(load(tmp_path, limit=5)) == 5
    assert montage(examples[:2], columns=2).shape == (848, 1024, 3)


def test_misuse_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="no shard"):
        load(tmp_path)
    with pytest.raises(UserError, match="multiple of 64"):
        generate(tmp_path, size=1, seed=0, start=3)
    (tmp_path / "shard-00000.npz").write_bytes(b"not a shard")
    with pytest.raises(AssetError, match="generate it again"):
        load(tmp_path)
