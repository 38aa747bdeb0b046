"""Image files: decoded only if they fit into the memory."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from toolee_robot.runtime.files import read_bytes

LARGEST_IMAGE = 50_000_000
"""Most pixels of an image that is decoded; RGB-D cameras have up to 12 million."""
LARGEST_FILE = 512 * 1024**2
"""Largest image file [bytes]."""


def read_image(path: Path, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any] | None:
    """Read an image file.

    Args:
        path: The file.
        flags: OpenCV's flags.

    Returns:
        The image, its channels in OpenCV's order; None if it is none.

    Raises:
        OSError: It cannot be read.
        ValueError: It is too large, or damaged.
    """
    return decode_image(read_bytes(path, LARGEST_FILE), flags)


def decode_image(packed: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any] | None:
    """Decode an image; see `read_image`.

    Args:
        packed: The content of an image file.
        flags: OpenCV's flags.

    Returns:
        The image; None if it is none.

    Raises:
        ValueError: It is too large, or damaged.
    """
    _check_size(packed)
    try:
        image = cv2.imdecode(np.frombuffer(packed, np.uint8), flags)
    except cv2.error as error:
        raise ValueError(f"it cannot be decoded ({error.err})") from None
    return None if image is None else np.asarray(image)


def _check_size(packed: bytes) -> None:
    """Refuse an image that would fill the memory, before it is decoded. OpenCV reports what is no image."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # OpenCV reports damage
            width, height = Image.open(BytesIO(packed)).size
    except Image.DecompressionBombError:
        raise ValueError(f"it has more than {LARGEST_IMAGE:,} pixels") from None
    except (OSError, ValueError, SyntaxError):
        return
    if width * height > LARGEST_IMAGE:
        raise ValueError(f"it has {width}x{height} pixels, more than {LARGEST_IMAGE:,}")
