"""Read colour and depth images from files, in any unit and bit depth, with checks of what is in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import UserError, words_of
from toolee_robot.perception.cloud import check_depth_unit
from toolee_robot.runtime.files import read_array
from toolee_robot.runtime.images import read_image

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
