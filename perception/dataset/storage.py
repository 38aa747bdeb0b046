"""Shards on disk and back: `shard-00000.npz`, ... of consecutive examples; equal content gives equal bytes.

A shard holds colour as JPEG (quality 95, full chroma), depth as PNG (uint16, mm), the id maps deflated, and the tables
as plain arrays. `load` decodes a folder into the arrays that training wants.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from toolee_robot.errors import AssetError
from toolee_robot.perception.dataset.records import HEIGHT, WIDTH, EeTable, Example
from toolee_robot.types import CameraIntrinsics

_TABLE = tuple(field.name for field in fields(EeTable))


def shard_path(folder: Path, number: int) -> Path:
    """Where shard `number` of a data set lies."""
    return folder / f"shard-{number:05d}.npz"


def write_shard(path: Path, examples: Sequence[Example]) -> None:
    """Write examples as one shard, whole or not at all."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, blobs in (
        ("rgb", [_jpeg(e.rgb) for e in examples]),
        ("depth", [_png(e.depth_mm) for e in examples]),
        ("ids", [zlib.compress((e.tool << 4 | e.ee).tobytes(), 6) for e in examples]),
    ):
        arrays[name] = np.frombuffer(b"".join(blobs), np.uint8)
        arrays[name + "_ends"] = np.cumsum([len(blob) for blob in blobs]).astype(np.int64)
    for name in _TABLE:
        arrays[name] = np.stack([getattr(e.table, name) for e in examples])
    arrays["intrinsics"] = np.array(
        [(e.intrinsics.fx, e.intrinsics.fy, e.intrinsics.cx, e.intrinsics.cy) for e in examples], np.float64
    )
    arrays["scene"] = np.array([e.scene for e in examples], np.uint8)
    scratch = path.with_suffix(".part")
    with scratch.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    scratch.replace(path)


@dataclass(frozen=True, eq=False)
class SegmentationSet:
    """A loaded data set of N images. rgb (N, H, W, 3) uint8; depth_mm (N, H, W) uint16 or None if not asked for;
    ee, tool (N, H, W) uint8 ids, 0 for none; table: `EeTable` with leading shape (N, 8); intrinsics (N, 4): fx, fy, cx,
    cy [px]; scene (N,): 0 hard, 1 station, 2 without tools."""

    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.uint16] | None
    ee: NDArray[np.uint8]
    tool: NDArray[np.uint8]
    table: EeTable
    intrinsics: NDArray[np.float64]
    scene: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.rgb)

    @property
    def categories(self) -> NDArray[np.uint8]:
        """(N, 8) class index (1..4, the order of `Category`) of EE id 1..8, 0 where there is none."""
        return self.table.category

    def example(self, i: int) -> Example:
        """Image i on its own."""
        fx, fy, cx, cy = (float(v) for v in self.intrinsics[i])
        table = EeTable(**{name: getattr(self.table, name)[i] for name in _TABLE})
        depth = np.zeros((HEIGHT, WIDTH), np.uint16) if self.depth_mm is None else self.depth_mm[i]
        return Example(
            self.rgb[i],
            depth,
            self.ee[i],
            self.tool[i],
            table,
            CameraIntrinsics(fx, fy, cx, cy, WIDTH, HEIGHT),
            int(self.scene[i]),
        )


def load(folder: Path, depth: bool = False, limit: int | None = None, threads: int = 8) -> SegmentationSet:
    """Read (the first `limit` images of) a data set. Raises AssetError naming a missing or broken file."""
    paths = sorted(folder.glob("shard-*.npz"))
    if not paths:
        raise AssetError(
            f"no shard-*.npz in {folder}: make them with `python -m toolee_robot.perception.dataset.generate`"
        )
    return load_shards(paths, depth, limit, threads)


def load_shards(
    paths: Sequence[Path], depth: bool = False, limit: int | None = None, threads: int = 8
) -> SegmentationSet:
    """Read (the first `limit` images of) some shards. Raises AssetError naming a missing or broken file."""
    shards: list[dict[str, NDArray[Any]]] = []
    count = 0
    for path in paths:
        if limit is not None and count >= limit:
            break
        try:
            with np.load(path, allow_pickle=False) as file:
                shards.append({name: file[name] for name in file.files if depth or not name.startswith("depth")})
        except (OSError, ValueError, KeyError, EOFError) as error:
            raise AssetError(f"cannot read {path}: {error}; generate it again") from error
        count += len(shards[-1]["scene"])
    total = count if limit is None else min(count, limit)
    rgb = np.empty((total, HEIGHT, WIDTH, 3), np.uint8)
    ids = np.empty((total, HEIGHT, WIDTH), np.uint8)
    depth_mm = np.empty((total, HEIGHT, WIDTH), np.uint16) if depth else None
    where = [(shard, k) for shard in shards for k in range(len(shard["scene"]))][:total]

    def decode(i: int) -> None:
        shard, k = where[i]
        rgb[i] = np.asarray(Image.open(BytesIO(_blob(shard, "rgb", k))))
        ids[i] = np.frombuffer(zlib.decompress(_blob(shard, "ids", k)), np.uint8).reshape(HEIGHT, WIDTH)
        if depth_mm is not None:
            depth_mm[i] = np.asarray(Image.open(BytesIO(_blob(shard, "depth", k))))

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(decode, range(total)))
    joined = {
        name: np.concatenate([shard[name] for shard in shards])[:total] for name in (*_TABLE, "intrinsics", "scene")
    }
    table = EeTable(**{name: joined[name] for name in _TABLE})
    return SegmentationSet(
        rgb,
        depth_mm,
        ids & np.uint8(15),
        ids >> np.uint8(4),
        table,
        joined["intrinsics"].astype(np.float64),
        joined["scene"].astype(np.uint8),
    )


def _blob(shard: dict[str, NDArray[Any]], name: str, k: int) -> bytes:
    ends = shard[name + "_ends"]
    start = int(ends[k - 1]) if k else 0
    return shard[name][start : int(ends[k])].tobytes()


def _jpeg(rgb: NDArray[np.uint8]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(rgb).save(buffer, "JPEG", quality=95, subsampling=0)
    return buffer.getvalue()


def _png(depth: NDArray[np.uint16]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(depth).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()
