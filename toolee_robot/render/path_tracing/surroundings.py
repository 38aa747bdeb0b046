"""Measured surroundings and photographed surfaces, read from a folder of files that the project does not contain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import UserError
from toolee_robot.render.mesh import FloatArray
from toolee_robot.runtime.files import sha256

_MEDIAN, _BRIGHTEST = 0.2, 60.0
"""Linear brightness that the median of a panorama is scaled to, and the largest one that is kept: the sun's disc would
need thousands of samples a pixel."""
_TEXTURE_SIZE = 512
"""Largest side of a texture [px]."""
_SUFFIXES = {".hdr": "panorama", ".jpg": "texture", ".jpeg": "texture", ".png": "texture"}


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What surrounds a scene and what its surfaces show.

    Attributes:
        panoramas: Equirectangular images of linear radiance, up at the top, (H, W, 3) float32 each.
        textures: Images of surfaces, linear RGB in [0, 1], (H, W, 3) float32 each; those of wood first.
        woods: Number of those of wood.
        prints: Pieces of the panoramas, as printed on boxes and walls, linear RGB in [0, 1], (H, W, 3) float32 each.
    """

    panoramas: tuple[FloatArray, ...] = ()
    textures: tuple[FloatArray, ...] = ()
    woods: int = 0
    prints: tuple[FloatArray, ...] = ()


def surroundings_files(folder: Path) -> tuple[tuple[str, str], ...]:
    """List the files of a folder of surroundings.

    Args:
        folder: Folder with panoramas (.hdr, equirectangular) and photographed surfaces (.jpg, .png; of wood where the
            name says so).

    Returns:
        Name and SHA-256 of each file, sorted by name.

    Raises:
        UserError: The folder has no panorama.
    """
    paths = sorted(p for p in folder.glob("*") if p.suffix.lower() in _SUFFIXES) if folder.is_dir() else []
    if not any(_SUFFIXES[p.suffix.lower()] == "panorama" for p in paths):
        raise UserError(
            f"--surroundings {folder}: no panorama there, give a folder with equirectangular .hdr files "
            "(docs/dataset.md names some)",
            code="user.no_panorama",
        )
    return tuple((p.name, sha256(p)) for p in paths)


@lru_cache(maxsize=1)
def read_surroundings(folder: Path, files: tuple[tuple[str, str], ...]) -> Surroundings:
    """Read the files that a data set is made with.

    Args:
        folder: The folder.
        files: Name and SHA-256 of each file.

    Returns:
        The surroundings.

    Raises:
        UserError: A file is missing, another one, or no image.
    """
    panoramas, textures = [], []
    for name, digest in sorted(files, key=lambda file: ("wood" not in file[0].lower(), file[0])):
        path = folder / name
        if not path.is_file() or sha256(path) != digest:
            raise UserError(
                f"{path} is not the file that the data set was begun with: give the same --surroundings, or another "
                "--out",
                code="user.other_surroundings",
            )
        image: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is None or image.ndim != 3 or image.shape[2] < 3:
            raise UserError(f"{path} is no colour image: take it out of --surroundings", code="user.no_image")
        rgb = np.ascontiguousarray(image[..., 2::-1])
        if _SUFFIXES[path.suffix.lower()] == "panorama":
            panoramas.append(_panorama(rgb))
        else:
            textures.append(_texture(rgb))
    woods = sum("wood" in name.lower() and _SUFFIXES[Path(name).suffix.lower()] == "texture" for name, _ in files)
    prints = [piece for image in panoramas for piece in _pieces(image)]
    return Surroundings(tuple(panoramas), tuple(textures), woods, tuple(prints))


def _panorama(rgb: NDArray[Any]) -> FloatArray:
    brightness = max(float(np.median(rgb.mean(axis=2))), 1e-6)
    return np.clip(rgb.astype(np.float32) * (_MEDIAN / brightness), 0.0, _BRIGHTEST)


def _pieces(panorama: FloatArray) -> list[FloatArray]:
    """Eight squares along the horizon and below, with highlights compressed."""
    side = panorama.shape[1] // 8
    top = panorama.shape[0] // 2 - side // 2
    squares = [panorama[top : top + side, k * side : (k + 1) * side] for k in range(8)]
    return [np.ascontiguousarray(2.0 * square / (1.0 + 2.0 * square), np.float32) for square in squares]


def _texture(rgb: NDArray[Any]) -> FloatArray:
    scale = min(1.0, _TEXTURE_SIZE / max(rgb.shape[:2]))
    small: Any = cv2.resize(rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return ((small.astype(np.float32) / np.iinfo(rgb.dtype).max) ** 2.2).astype(np.float32)
