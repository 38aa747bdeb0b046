"""Read frames from files: images, intrinsics, hand poses, and scene folders in the BOP layout.

Every mistake in the input is a `UserError` that names the file and says what to do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import UserError, words_of
from toolee_robot.frames import Array, is_rigid
from toolee_robot.perception.cloud import check_depth_unit
from toolee_robot.runtime.files import read_array, read_json, read_text
from toolee_robot.runtime.images import read_image
from toolee_robot.types import CameraIntrinsics, RgbdFrame, ToolEstimate

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
"""Image files that are read; .npy arrays as well."""


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Read a colour image.

    Args:
        path: Image or .npy file. Grey is repeated over the channels, alpha dropped, 16 bits reduced to 8.

    Returns:
        (H, W, 3) uint8 RGB.

    Raises:
        UserError: The file is missing, unreadable or not a colour image.
    """
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
    """Read a depth image.

    Args:
        path: 16-bit or float image, or .npy file, one channel.
        scale: Metres per unit of the file: 0.001 for millimetres, 1 for metres.

    Returns:
        Depth (H, W) [m] along the optical axis; 0 (unknown) where the file holds NaN, infinity or 0.

    Raises:
        UserError: The file is unreadable, holds negative or only unknown depth, or the result cannot be in metres.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise UserError(
            f"--depth-scale is {scale}: give the metres of one unit, 0.001 for millimetres, 1 for metres",
            code="user.depth_scale",
        )
    data = _read_array(path, "depth")
    if data.ndim == 3 and data.shape[2] == 1:
        data = data[:, :, 0]
    if data.ndim != 2:
        raise UserError(
            f"depth {path} has shape {data.shape}: it must have one channel; is it a picture of depth?",
            code="user.depth_shape",
        )
    if data.dtype == np.uint8:
        raise UserError(
            f"depth {path} has 8 bits, too few for a distance: save it with 16 bits or as float", code="user.depth_type"
        )
    if not (np.issubdtype(data.dtype, np.integer) or np.issubdtype(data.dtype, np.floating)):
        raise UserError(
            f"depth {path} holds {data.dtype}: save numbers, as 16-bit integers or float", code="user.depth_type"
        )
    depth = data.astype(np.float64) * scale
    depth[~np.isfinite(depth)] = 0.0
    if not depth.any():
        raise UserError(
            f"depth {path} holds no known distance, every pixel is 0, NaN or infinite: record it again",
            code="user.depth_unknown",
        )
    try:
        check_depth_unit(depth)
    except UserError as error:
        raise UserError(f"{path}: {error}", code=error.code) from None
    return depth.astype(np.float32)


def _read_array(path: Path, what: str) -> NDArray[Any]:
    """Read a file's pixels in RGB order, bit depth kept; `what` names the file's role in messages."""
    if not path.is_file():
        raise UserError(f"{what} file {path} does not exist", code="user.file_missing")
    if path.suffix.lower() == ".npy":
        try:
            return read_array(path)
        except (OSError, ValueError) as error:
            raise UserError(
                f"{what} file {path} is not a readable .npy array: {words_of(error)}", code="user.file_unreadable"
            ) from error
    try:
        data = read_image(path)
    except (OSError, ValueError) as error:
        raise UserError(
            f"cannot read the {what} file {path}: {words_of(error)}", code="user.file_unreadable"
        ) from error
    if data is None:
        raise UserError(
            f"{what} file {path} is not a readable image: use {', '.join(IMAGE_SUFFIXES)} or .npy",
            code="user.file_unreadable",
        )
    if data.ndim == 3 and data.shape[2] >= 3:
        data = data[:, :, [2, 1, 0, *range(3, data.shape[2])]]
    return data


LONGEST_OF_A_PART = 20.0
"""Largest focal length of a part that was cut out of an image, in widths of the part."""


def parse_intrinsics(text: str, width: int, height: int) -> CameraIntrinsics:
    """Parse intrinsics from "fx,fy,cx,cy" [px] and check them against the image size.

    Args:
        text: Four comma-separated numbers [px].
        width: Image width [px].
        height: Image height [px].

    Returns:
        The camera's intrinsics.

    Raises:
        UserError: The text is not four numbers, or they cannot be a camera's; see `make_intrinsics`.
    """
    try:
        values = [float(v) for v in text.replace(" ", "").split(",")]
    except ValueError as error:
        raise UserError(
            f"--intrinsics {text!r}: give four numbers, fx,fy,cx,cy, in pixels", code="user.intrinsics"
        ) from error
    if len(values) != 4:
        raise UserError(
            f"--intrinsics {text!r} has {len(values)} numbers: give four, fx,fy,cx,cy, in pixels",
            code="user.intrinsics",
        )
    fx, fy, cx, cy = values
    return make_intrinsics(fx, fy, cx, cy, width, height)


def make_intrinsics(fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> CameraIntrinsics:
    """Checked pinhole intrinsics.

    Args:
        fx: Focal length in x [px].
        fy: Focal length in y [px].
        cx: Principal point in x [px].
        cy: Principal point in y [px].
        width: Image width [px].
        height: Image height [px].

    Returns:
        The camera's intrinsics.

    Raises:
        UserError: No camera has them; see `CameraIntrinsics.problems`.
    """
    camera = CameraIntrinsics(fx, fy, cx, cy, width, height)
    if wrong := camera.problems(longest=LONGEST_OF_A_PART):
        told = "; ".join(f"{name}: {text}" for name, text in wrong)
        raise UserError(
            f"these are not intrinsics of the {width}x{height} image in pixels: {told}", code="user.intrinsics"
        )
    return camera


def read_pose(path: Path) -> Array:
    """Read a rigid transform from a file.

    Args:
        path: .npy, .json (16 numbers, nested or flat) or a text file with 16 (4x4) or 12 (3x4) numbers, row-major,
            translation [m]. Rotations that are orthonormal within 1e-3 (rounding in a text file) are orthonormalised.

    Returns:
        The transform, 4x4.

    Raises:
        UserError: The file is unreadable, not a rigid transform, or its translation is over 20 m.
    """
    try:
        if path.suffix == ".npy":
            values: Any = read_array(path)
        elif path.suffix == ".json":
            data = read_json(path)
            values = next(iter(data.values())) if isinstance(data, dict) and len(data) == 1 else data
        else:
            values = [float(v) for v in read_text(path).replace(",", " ").replace("[", " ").replace("]", " ").split()]
        flat = np.asarray(values, dtype=np.float64).reshape(-1)
    except OSError as error:
        raise UserError(f"cannot read the pose file {path}: {words_of(error)}", code="user.pose_unreadable") from error
    except (ValueError, TypeError, UnicodeDecodeError) as error:
        raise UserError(
            f"{path} is not a pose: give 16 numbers, a row-major 4x4 matrix in metres ({error})",
            code="user.pose_unreadable",
        ) from error
    if flat.size == 12:
        flat = np.concatenate([flat, [0.0, 0.0, 0.0, 1.0]])
    if flat.size != 16:
        raise UserError(
            f"{path} holds {flat.size} numbers: give 16, a row-major 4x4 matrix in metres", code="user.pose_size"
        )
    X = flat.reshape(4, 4)
    if not is_rigid(X, 1e-3):
        raise UserError(
            f"{path} is not a rigid transform (rotation not orthonormal, or last row not 0 0 0 1):\n{X}",
            code="user.pose_not_rigid",
        )
    if np.linalg.norm(X[:3, 3]) > 20:
        raise UserError(
            f"{path}: the hand is {np.linalg.norm(X[:3, 3]):.0f} m from the camera: give metres, not millimetres",
            code="user.pose_unit",
        )
    U, _, Vt = np.linalg.svd(X[:3, :3])
    X[:3, :3] = U @ Vt
    return X


def read_frame(rgb: Path, depth: Path, intrinsics: str, depth_scale: float = 1.0) -> RgbdFrame:
    """Read a frame from image files.

    Args:
        rgb: Colour image; see `read_rgb`.
        depth: Depth image registered to the colour image; see `read_depth`.
        intrinsics: "fx,fy,cx,cy" [px].
        depth_scale: Metres per unit of the depth file.

    Returns:
        The frame.

    Raises:
        UserError: A file or value is unusable, or the two images differ in size.
    """
    image = read_rgb(rgb)
    height, width = image.shape[:2]
    return _frame(rgb, image, depth, read_depth(depth, depth_scale), parse_intrinsics(intrinsics, width, height))


@dataclass(frozen=True)
class BopImage:
    """One image of a BOP scene folder, to be read on demand.

    Attributes:
        im_id: Image id, as in scene_camera.json and the file names.
        rgb: Colour image file.
        depth: Depth image file.
        K: Camera matrix, 9 numbers, row-major [px].
        scale: Metres per unit of the depth file.
    """

    im_id: int
    rgb: Path
    depth: Path
    K: tuple[float, ...]
    scale: float

    def read(self) -> RgbdFrame:
        """Read the frame.

        Returns:
            The frame.

        Raises:
            UserError: As `read_frame`.
        """
        image = read_rgb(self.rgb)
        height, width = image.shape[:2]
        fx, _, cx, _, fy, cy = self.K[:6]
        intrinsics = make_intrinsics(fx, fy, cx, cy, width, height)
        try:
            depth = read_depth(self.depth, self.scale)
        except UserError as error:
            if error.code != "user.depth_unit":
                raise
            raise UserError(  # whose remedy is an option of a single frame
                f"{self.depth}: with the depth_scale {self.scale * 1e3:g} of scene_camera.json no depth is "
                "plausible in metres. Give the millimetres per unit there: 1 for millimetres, 0.1 for tenths",
                code=error.code,
            ) from error
        return _frame(self.rgb, image, self.depth, depth, intrinsics)


def bop_images(directory: Path) -> list[BopImage]:
    """The images of a BOP scene folder (rgb/, depth/, scene_camera.json), ordered by image id.

    Args:
        directory: The scene folder. scene_camera.json maps an image id to {"cam_K": 9 numbers [px], "depth_scale":
            millimetres per unit of the depth file}.

    Returns:
        The images, not read yet.

    Raises:
        UserError: The folder is not a BOP scene, or a file that scene_camera.json or rgb/ names is missing.
    """
    path = directory / "scene_camera.json"
    if not directory.is_dir():
        raise UserError(
            f"{directory} is not a folder: give a BOP scene folder with rgb/, depth/ and scene_camera.json",
            code="user.bop_folder",
        )
    try:
        cameras = read_json(path)
    except OSError as error:
        raise UserError(
            f"cannot read {path}: a BOP scene folder has rgb/, depth/ and scene_camera.json", code="user.bop_camera"
        ) from error
    except ValueError as error:
        raise UserError(f"{path} is not valid JSON: {error}", code="user.bop_camera") from error
    if not isinstance(cameras, dict) or not cameras:
        raise UserError(
            f"{path} names no images: it must map image ids to cam_K and depth_scale", code="user.bop_camera"
        )
    rgbs, depths = _by_id(directory / "rgb"), _by_id(directory / "depth")
    images = [_bop_image(path, key, entry, rgbs, depths) for key, entry in cameras.items()]
    unnamed = sorted(set(rgbs) - {image.im_id for image in images})
    if unnamed and not (directory / "recording.json").exists():  # a recording that was killed names most of its frames
        raise UserError(
            f"{path} lacks image {unnamed[0]}, which {rgbs[unnamed[0]]} shows: add its cam_K and depth_scale",
            code="user.bop_camera",
        )
    return sorted(images, key=lambda image: image.im_id)


def _bop_image(path: Path, key: str, entry: Any, rgbs: dict[int, Path], depths: dict[int, Path]) -> BopImage:
    try:
        im_id = int(key)
        K = tuple(float(v) for v in entry["cam_K"])
        scale = float(entry.get("depth_scale", 1.0)) / 1000.0
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(
            f'{path}, image "{key}": needs "cam_K" (9 numbers) and "depth_scale" ({error!r})', code="user.bop_camera"
        ) from error
    if len(K) != 9:
        raise UserError(f'{path}, image "{key}": cam_K has {len(K)} numbers, not 9', code="user.bop_camera")
    if (K[1], K[3], *K[6:]) != (0.0, 0.0, 0.0, 0.0, 1.0):
        raise UserError(
            f'{path}, image "{key}": cam_K is not a camera matrix by rows, fx 0 cx, 0 fy cy, 0 0 1',
            code="user.bop_camera",
        )
    if not 0.0 < scale < 1.0:
        raise UserError(
            f'{path}, image "{key}": depth_scale {scale * 1e3:g} is not plausible. Give the millimetres '
            "per unit: 1 for millimetres, 0.1 for tenths",
            code="user.bop_camera",
        )
    for kind, files in (("rgb", rgbs), ("depth", depths)):
        if im_id not in files:
            raise UserError(
                f"{path} names image {im_id}, but {path.parent / kind} has no {im_id:06d} image",
                code="user.bop_image_missing",
            )
    return BopImage(im_id, rgbs[im_id], depths[im_id], K, scale)


def _by_id(directory: Path) -> dict[int, Path]:
    if not directory.is_dir():
        raise UserError(
            f"{directory} is missing: a BOP scene folder has rgb/, depth/ and scene_camera.json", code="user.bop_folder"
        )
    files = [p for p in sorted(directory.iterdir()) if p.suffix.lower() in (*IMAGE_SUFFIXES, ".npy")]
    return {int(p.stem): p for p in files if p.stem.isdigit()}


def _frame(
    rgb: Path, image: NDArray[np.uint8], path: Path, depth: NDArray[np.float32], intrinsics: CameraIntrinsics
) -> RgbdFrame:
    if depth.shape != image.shape[:2]:
        raise UserError(
            f"{path} is {depth.shape[1]}x{depth.shape[0]} but {rgb} is {image.shape[1]}x{image.shape[0]}: "
            "register the depth to the colour image",
            code="user.depth_not_registered",
        )
    return RgbdFrame(image, depth, intrinsics)


def as_record(estimate: ToolEstimate) -> dict[str, Any]:
    """An estimate for JSON: metres, radians, OpenCV camera frame; mask_box is x0, y0, x1, y1 [px].

    X_camera_ee and covariance are null where there was too little to estimate a pose from.
    """
    known = bool(np.all(np.isfinite(estimate.X_camera_ee)))
    return {
        "category": str(estimate.category),
        "score": round(float(estimate.detection.score), 4),
        "X_camera_ee": [float(v) for v in estimate.X_camera_ee.reshape(-1)] if known else None,
        "covariance": estimate.covariance.tolist() if known else None,
        "mask_box": [float(v) for v in estimate.detection.box],
        "confidence": round(float(estimate.confidence), 4),
        "trust": round(float(estimate.trust), 4),
        "usable": bool(estimate.usable),
        "reason": estimate.reason,
    }
