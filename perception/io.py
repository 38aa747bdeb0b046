"""Files to frames: images, depth in any unit, intrinsics, hand poses, and scene folders in the BOP layout.

Everything a person can get wrong here is a `UserError` that names the file and says what to do.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, is_rigid
from toolee_robot.perception.cloud import check_depth_unit
from toolee_robot.types import CameraIntrinsics, RgbdFrame

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB from an image or a .npy file; grey is repeated, alpha dropped, 16 bits halved."""
    data = _read_array(path, "rgb")
    if data.dtype == np.uint16:
        data = (data >> 8).astype(np.uint8)
    if data.dtype != np.uint8:
        raise UserError(f"rgb {path} holds {data.dtype}: it must be 8-bit colour, 0 to 255")
    if data.ndim == 2:
        data = np.repeat(data[:, :, None], 3, axis=2)
    if data.ndim != 3 or data.shape[2] not in (3, 4):
        raise UserError(f"rgb {path} has shape {data.shape}: it must be (height, width, 3)")
    return np.ascontiguousarray(data[:, :, :3])


def read_depth(path: Path, scale: float = 1.0) -> NDArray[np.float32]:
    """Depth (H, W) [m] from a 16-bit or float image or a .npy file; `scale` is the metres of one unit of the file.

    NaN, infinite and zero pixels become 0: unknown. Raises UserError for negative or all-unknown depth and when the
    result cannot be metres.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise UserError(f"--depth-scale is {scale}: give the metres of one unit, 0.001 for millimetres, 1 for metres")
    data = _read_array(path, "depth")
    if data.ndim == 3 and data.shape[2] == 1:
        data = data[:, :, 0]
    if data.ndim != 2:
        raise UserError(f"depth {path} has shape {data.shape}: it must have one channel; is it a picture of depth?")
    if data.dtype == np.uint8:
        raise UserError(f"depth {path} has 8 bits, too few for a distance: save it with 16 bits or as float")
    if not (np.issubdtype(data.dtype, np.integer) or np.issubdtype(data.dtype, np.floating)):
        raise UserError(f"depth {path} holds {data.dtype}: save numbers, as 16-bit integers or float")
    depth = data.astype(np.float64) * scale
    depth[~np.isfinite(depth)] = 0.0
    if not depth.any():
        raise UserError(f"depth {path} holds no known distance, every pixel is 0, NaN or infinite: record it again")
    try:
        check_depth_unit(depth)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    return depth.astype(np.float32)


def parse_intrinsics(text: str, width: int, height: int) -> CameraIntrinsics:
    """Intrinsics [px] from "fx,fy,cx,cy", checked against the image's size."""
    try:
        values = [float(v) for v in text.replace(" ", "").split(",")]
    except ValueError as error:
        raise UserError(f"--intrinsics {text!r}: give four numbers, fx,fy,cx,cy, in pixels") from error
    if len(values) != 4:
        raise UserError(f"--intrinsics {text!r} has {len(values)} numbers: give four, fx,fy,cx,cy, in pixels")
    fx, fy, cx, cy = values
    return make_intrinsics(fx, fy, cx, cy, width, height)


def make_intrinsics(fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> CameraIntrinsics:
    """Checked intrinsics: finite, positive focal lengths, the centre in the image."""
    if not np.all(np.isfinite([fx, fy, cx, cy])):
        raise UserError(f"intrinsics {fx},{fy},{cx},{cy} are not finite: give four numbers in pixels")
    if fx <= 0 or fy <= 0:
        raise UserError(f"focal lengths must be positive pixels, got fx {fx}, fy {fy}")
    if fx < 10:
        raise UserError(f"fx = {fx} px is no camera's focal length: give pixels, not millimetres")
    if not (0 <= cx <= width and 0 <= cy <= height):
        raise UserError(
            f"the image centre {cx},{cy} lies outside of the {width}x{height} image: wrong order or camera?"
        )
    return CameraIntrinsics(fx, fy, cx, cy, width, height)


def read_pose(path: Path) -> Array:
    """4x4 rigid transform from .npy, .json (16 numbers, nested or not) or text with 16 (or 12, 3x4) numbers [m].

    Rotations off orthonormal by up to 1e-3 (rounding in a text file) are made orthonormal.
    """
    try:
        if path.suffix == ".npy":
            values = np.load(path, allow_pickle=False)
        elif path.suffix == ".json":
            data = json.loads(path.read_text())
            values = next(iter(data.values())) if isinstance(data, dict) and len(data) == 1 else data
        else:
            values = [float(v) for v in path.read_text().replace(",", " ").replace("[", " ").replace("]", " ").split()]
        flat = np.asarray(values, dtype=np.float64).reshape(-1)
    except OSError as error:
        raise UserError(f"cannot read the pose file {path}: {error.strerror or error}") from error
    except (ValueError, TypeError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not a pose: give 16 numbers, a row-major 4x4 matrix in metres ({error})") from error
    if flat.size == 12:
        flat = np.concatenate([flat, [0.0, 0.0, 0.0, 1.0]])
    if flat.size != 16:
        raise UserError(f"{path} holds {flat.size} numbers: give 16, a row-major 4x4 matrix in metres")
    X = flat.reshape(4, 4)
    if not is_rigid(X, 1e-3):
        raise UserError(f"{path} is not a rigid transform (rotation not orthonormal, or last row not 0 0 0 1):\n{X}")
    if np.linalg.norm(X[:3, 3]) > 20:
        raise UserError(
            f"{path}: the hand is {np.linalg.norm(X[:3, 3]):.0f} m from the camera: give metres, not millimetres"
        )
    U, _, Vt = np.linalg.svd(X[:3, :3])
    X[:3, :3] = U @ Vt
    return X


def read_frame(rgb: Path, depth: Path, intrinsics: str, depth_scale: float = 1.0) -> RgbdFrame:
    """A frame from files: an image, the depth registered to it, and "fx,fy,cx,cy" [px]."""
    image = read_rgb(rgb)
    height, width = image.shape[:2]
    return _frame(rgb, image, depth, read_depth(depth, depth_scale), parse_intrinsics(intrinsics, width, height))


@dataclass(frozen=True)
class BopImage:
    """One image of a scene folder, not read yet. scale: metres of one unit of its depth file."""

    im_id: int
    rgb: Path
    depth: Path
    K: tuple[float, ...]
    scale: float

    def read(self) -> RgbdFrame:
        image = read_rgb(self.rgb)
        height, width = image.shape[:2]
        fx, _, cx, _, fy, cy = self.K[:6]
        intrinsics = make_intrinsics(fx, fy, cx, cy, width, height)
        return _frame(self.rgb, image, self.depth, read_depth(self.depth, self.scale), intrinsics)


def bop_images(directory: Path) -> list[BopImage]:
    """The images of a BOP scene folder (rgb/, depth/, scene_camera.json), by image id.

    scene_camera.json: {"0": {"cam_K": [9 numbers], "depth_scale": millimetres of one unit}, ...}. Raises UserError
    when the folder is no scene, and for each file that scene_camera.json or rgb/ names and that is missing.
    """
    path = directory / "scene_camera.json"
    if not directory.is_dir():
        raise UserError(f"{directory} is not a folder: give a BOP scene folder with rgb/, depth/ and scene_camera.json")
    try:
        cameras = json.loads(path.read_text())
    except OSError as error:
        raise UserError(f"cannot read {path}: a BOP scene folder has rgb/, depth/ and scene_camera.json") from error
    except ValueError as error:
        raise UserError(f"{path} is not valid JSON: {error}") from error
    if not isinstance(cameras, dict) or not cameras:
        raise UserError(f"{path} names no images: it must map image ids to cam_K and depth_scale")
    rgbs, depths = _by_id(directory / "rgb"), _by_id(directory / "depth")
    images = [_bop_image(path, key, entry, rgbs, depths) for key, entry in cameras.items()]
    unnamed = sorted(set(rgbs) - {image.im_id for image in images})
    if unnamed:
        raise UserError(
            f"{path} lacks image {unnamed[0]}, which {rgbs[unnamed[0]]} shows: add its cam_K and depth_scale"
        )
    return sorted(images, key=lambda image: image.im_id)


def _bop_image(path: Path, key: str, entry: Any, rgbs: dict[int, Path], depths: dict[int, Path]) -> BopImage:
    try:
        im_id = int(key)
        K = tuple(float(v) for v in entry["cam_K"])
        scale = float(entry.get("depth_scale", 1.0)) / 1000.0
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f'{path}, image "{key}": needs "cam_K" (9 numbers) and "depth_scale" ({error!r})') from error
    if len(K) != 9:
        raise UserError(f'{path}, image "{key}": cam_K has {len(K)} numbers, not 9')
    for kind, files in (("rgb", rgbs), ("depth", depths)):
        if im_id not in files:
            raise UserError(f"{path} names image {im_id}, but {path.parent / kind} has no {im_id:06d} image")
    return BopImage(im_id, rgbs[im_id], depths[im_id], K, scale)


def _by_id(directory: Path) -> dict[int, Path]:
    if not directory.is_dir():
        raise UserError(f"{directory} is missing: a BOP scene folder has rgb/, depth/ and scene_camera.json")
    files = [p for p in sorted(directory.iterdir()) if p.suffix.lower() in (*IMAGE_SUFFIXES, ".npy")]
    return {int(p.stem): p for p in files if p.stem.isdigit()}


def _frame(
    rgb: Path, image: NDArray[np.uint8], path: Path, depth: NDArray[np.float32], intrinsics: CameraIntrinsics
) -> RgbdFrame:
    if depth.shape != image.shape[:2]:
        raise UserError(
            f"{path} is {depth.shape[1]}x{depth.shape[0]} but {rgb} is {image.shape[1]}x{image.shape[0]}: "
            "register the depth to the colour image"
        )
    return RgbdFrame(image, depth, intrinsics)


def _read_array(path: Path, what: str) -> NDArray[Any]:
    """The file's pixels, RGB order, bit depth kept."""
    if not path.is_file():
        raise UserError(f"{what} file {path} does not exist")
    if path.suffix.lower() == ".npy":
        try:
            return np.asarray(np.load(path, allow_pickle=False))
        except (OSError, ValueError) as error:
            raise UserError(f"{what} file {path} is not a readable .npy array: {error}") from error
    try:
        data = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, cv2.error) as error:
        raise UserError(f"cannot read the {what} file {path}: {error}") from error
    if data is None:
        raise UserError(f"{what} file {path} is not a readable image: use {', '.join(IMAGE_SUFFIXES)} or .npy")
    if data.ndim == 3 and data.shape[2] >= 3:
        data = data[:, :, [2, 1, 0, *range(3, data.shape[2])]]
    return np.asarray(data)
