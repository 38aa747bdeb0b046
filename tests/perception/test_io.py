"""Frames from files: every format is read, every mistake is refused with its own code."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.perception.io import bop_images, parse_intrinsics, read_depth, read_pose, read_rgb


@pytest.fixture
def rgb() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)


@pytest.fixture
def depth_mm() -> np.ndarray:
    return np.random.default_rng(1).integers(500, 1500, (24, 32)).astype(np.uint16)


def write_png(path: Path, image: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)
    return path


def test_colour_comes_back_as_it_was_saved(tmp_path: Path, rgb: np.ndarray) -> None:
    np.testing.assert_array_equal(read_rgb(write_png(tmp_path / "a.png", rgb)), rgb)
    np.save(tmp_path / "a.npy", rgb)
    np.testing.assert_array_equal(read_rgb(tmp_path / "a.npy"), rgb)
    grey = write_png(tmp_path / "g.png", rgb[:, :, 0])
    np.testing.assert_array_equal(read_rgb(grey)[:, :, 2], rgb[:, :, 0])


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".npy"])
def test_depth_in_millimetres_becomes_metres(tmp_path: Path, depth_mm: np.ndarray, suffix: str) -> None:
    path = tmp_path / f"d{suffix}"
    if suffix == ".npy":
        np.save(path, depth_mm)
    else:
        write_png(path, depth_mm)
    np.testing.assert_allclose(read_depth(path, 0.001), depth_mm / 1000, rtol=1e-6)


def test_float_depth_with_holes(tmp_path: Path) -> None:
    depth = np.full((24, 32), 0.8, np.float32)
    depth[0, 0], depth[0, 1] = np.nan, np.inf
    path = tmp_path / "d.tiff"
    assert cv2.imwrite(str(path), depth)
    read = read_depth(path)
    assert read.dtype == np.float32
    assert read[0, 0] == 0
    assert read[0, 1] == 0
    assert read[1, 1] == pytest.approx(0.8)


def test_depth_mistakes_are_named(tmp_path: Path, depth_mm: np.ndarray, rgb: np.ndarray) -> None:
    path = write_png(tmp_path / "d.png", depth_mm)
    with raises(UserError, code="user.depth_unit"):
        read_depth(path)
    with raises(UserError, code="user.depth_unit"):
        read_depth(path, 1e-6)
    for scale in (0.0, -1.0, np.nan):
        with raises(UserError, code="user.depth_scale"):
            read_depth(path, scale)
    np.save(tmp_path / "nan.npy", np.full((4, 4), np.nan))
    with raises(UserError, code="user.depth_unknown"):
        read_depth(tmp_path / "nan.npy")
    np.save(tmp_path / "negative.npy", -np.ones((4, 4)))
    with raises(UserError, code="user.depth_negative"):
        read_depth(tmp_path / "negative.npy")
    np.save(tmp_path / "text.npy", np.full((4, 4), "a"))
    with raises(UserError, code="user.depth_type"):
        read_depth(tmp_path / "text.npy")
    with raises(UserError, code="user.depth_shape"):
        read_depth(write_png(tmp_path / "c.png", rgb))
    with raises(UserError, code="user.depth_type"):
        read_depth(write_png(tmp_path / "e.png", rgb[:, :, 0]))


def test_intrinsics_are_read() -> None:
    camera = parse_intrinsics("365.5, 366,16,12", 32, 24)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height) == (365.5, 366, 16, 12, 32, 24)


def test_poses_from_every_format(tmp_path: Path) -> None:
    X = transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.1, 0.2, 0.7])
    np.save(tmp_path / "p.npy", X)
    (tmp_path / "p.json").write_text(json.dumps(X.tolist()))
    (tmp_path / "q.json").write_text(json.dumps({"X_camera_hand": X.reshape(-1).tolist()}))
    (tmp_path / "p.txt").write_text(" ".join(f"{v:.4f}" for v in X.reshape(-1)))
    (tmp_path / "r.txt").write_text(", ".join(f"{v:.4f}" for v in X[:3].reshape(-1)))
    for name in ("p.npy", "p.json", "q.json", "p.txt", "r.txt"):
        np.testing.assert_allclose(read_pose(tmp_path / name), X, atol=1e-9)


def test_pose_mistakes_are_named(tmp_path: Path) -> None:
    scaled, far = np.eye(4) * 2, transform(None, [100.0, 0, 700.0])
    for name, content, code in (
        ("short.txt", "1 2 3", "user.pose_size"),
        ("words.txt", "one two", "user.pose_unreadable"),
        ("bad.json", "{", "user.pose_unreadable"),
        ("scaled.txt", " ".join(map(str, scaled.reshape(-1))), "user.pose_not_rigid"),
        ("nan.txt", " ".join(["nan"] * 16), "user.pose_not_rigid"),
        ("mm.txt", " ".join(map(str, far.reshape(-1))), "user.pose_unit"),
    ):
        (tmp_path / name).write_text(content)
        with raises(UserError, code=code) as refused:
            read_pose(tmp_path / name)
        assert name in str(refused.value)
    with raises(UserError, code="user.pose_unreadable"):
        read_pose(tmp_path / "absent.txt")


def make_scene(root: Path, rgb: np.ndarray, depth_mm: np.ndarray, ids: tuple[int, ...] = (3, 0, 12)) -> Path:
    cameras = {}
    for i in ids:
        write_png(root / "rgb" / f"{i:06d}.png", rgb)
        write_png(root / "depth" / f"{i:06d}.png", depth_mm * 10)
        cameras[str(i)] = {"cam_K": [365.0, 0, 16, 0, 366.0, 12, 0, 0, 1], "depth_scale": 0.1}
    (root / "scene_camera.json").write_text(json.dumps(cameras))
    return root


def test_a_bop_scene_is_read_in_order_with_its_depth_scale(
    tmp_path: Path, rgb: np.ndarray, depth_mm: np.ndarray
) -> None:
    images = bop_images(make_scene(tmp_path, rgb, depth_mm))
    assert [image.im_id for image in images] == [0, 3, 12]
    frame = images[0].read()
    np.testing.assert_allclose(frame.depth, depth_mm / 1000, rtol=1e-6)
    assert (frame.intrinsics.fy, frame.intrinsics.cx) == (366.0, 16.0)
    np.testing.assert_array_equal(frame.rgb, rgb)


def test_bop_mistakes_are_named_before_anything_is_read(tmp_path: Path, rgb: np.ndarray, depth_mm: np.ndarray) -> None:
    with raises(UserError, code="user.bop_folder"):
        bop_images(tmp_path / "absent")
    with raises(UserError, code="user.bop_camera"):
        bop_images(tmp_path)
    scene = make_scene(tmp_path, rgb, depth_mm)
    (scene / "depth" / "000003.png").unlink()
    with raises(UserError, code="user.bop_image_missing") as refused:
        bop_images(scene)
    assert "image 3" in str(refused.value)
    write_png(scene / "rgb" / "000099.png", rgb)
    write_png(scene / "depth" / "000003.png", depth_mm)
    with raises(UserError, code="user.bop_camera") as refused:
        bop_images(scene)
    assert "000099" in str(refused.value)
    for cameras in ("[]", "{", '{"0": {}}', '{"0": {"cam_K": [1, 2]}}', '{"zero": {"cam_K": [1]}}'):
        (scene / "scene_camera.json").write_text(cameras)
        with raises(UserError, code="user.bop_camera"):
            bop_images(scene)
