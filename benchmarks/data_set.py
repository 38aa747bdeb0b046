"""Pictures of a data set: montages with its labels, montage_train.png and montage_test.png.

python -m benchmarks.data_set DIR [--out PICTURES] [--count 12]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.perception.offline.dataset.records import EeTable, FloatArray
from toolee_robot.perception.offline.dataset.scenes import load_scenes, scene_folders
from toolee_robot.perception.offline.dataset.spec import SPLITS
from toolee_robot.types import CameraIntrinsics

_AXIS = 0.04
_SCALE = 2
"""Labels are drawn on an enlarged image: at its own size they hide it."""


def annotated(
    rgb: NDArray[np.uint8],
    ee: NDArray[np.uint8],
    tool: NDArray[np.uint8],
    table: EeTable,
    K: CameraIntrinsics,
    title: str = "",
) -> NDArray[np.uint8]:
    """Draw the labels into an image of twice the size: EEs tinted by category, tools outlined, axes, occlusion.

    Args:
        rgb: Colour image, (H, W, 3), sRGB.
        ee: Id of the EE at each pixel, (H, W), 0 for none.
        tool: Id of the tool at each pixel, (H, W), 0 for none.
        table: Labels of the EEs.
        K: Intrinsics of the camera.
        title: Text above the image.

    Returns:
        The drawing, sRGB, (2 H, 2 W, 3).
    """
    image = rgb.astype(np.float32)
    edge = np.zeros(tool.shape, bool)
    edge[1:] |= tool[1:] != tool[:-1]
    edge[:, 1:] |= tool[:, 1:] != tool[:, :-1]
    image[edge] = 255
    for row in np.flatnonzero(table.category):
        mask = ee == row + 1
        tint = ImageColor.getrgb(CATEGORIES[table.category[row] - 1].spec.color)
        image[mask] = 0.5 * image[mask] + 0.5 * np.asarray(tint, np.float32)
    canvas = Image.fromarray(image.astype(np.uint8)).resize(
        (K.width * _SCALE, K.height * _SCALE), Image.Resampling.BICUBIC
    )
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(20)
    targets = table.targets
    for row in np.flatnonzero(table.category):
        ends = _projected_axes(table.X_camera_ee[row], K)
        if ends is None:
            continue
        for axis, color in enumerate(("#ff3030", "#30ff30", "#4080ff")):
            draw.line([tuple(ends[0]), tuple(ends[axis + 1])], fill=color, width=4)
        name = CATEGORIES[table.category[row] - 1].label
        hidden = f"{100 * table.occlusion[row]:.0f} % hidden" if targets[row] else "no target"
        _text(draw, ends[0] + [8, 8], f"{name}, {hidden}", font, canvas.size)
    if title:
        _text(draw, np.array([8.0, 6.0]), title, font, canvas.size)
    return np.asarray(canvas)


def _projected_axes(X: FloatArray, K: CameraIntrinsics) -> NDArray[np.float64] | None:
    """(4, 2) pixels of the enlarged image: the origin and the three axes' ends; None behind or beside the camera."""
    ends = X[:3, 3].astype(np.float64) + np.vstack([np.zeros(3), _AXIS * X[:3, :3].T.astype(np.float64)])
    if ends[:, 2].min() < 0.05:
        return None
    pixels = ends[:, :2] / ends[:, 2:] * [K.fx, K.fy] + [K.cx, K.cy]
    if not (0 <= pixels[0, 0] < K.width and 0 <= pixels[0, 1] < K.height):
        return None
    return np.asarray((pixels + 0.5) * _SCALE)


def _text(draw: ImageDraw.ImageDraw, at: NDArray[np.float64], text: str, font: Any, size: tuple[int, int]) -> None:
    width = draw.textlength(text, font=font)
    x, y = min(float(at[0]), size[0] - width - 6), min(float(at[1]), size[1] - 28.0)
    draw.text((max(x, 4.0), y), text, fill="white", font=font, stroke_width=3, stroke_fill="black")


def depth_picture(depth_mm: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """(2 H, 2 W, 3) uint8: 0.3 m yellow to 1.5 m and beyond dark blue, unknown black."""
    import matplotlib

    level = np.clip((depth_mm.astype(np.float32) - 300) / 1200, 0, 1)
    colors = (255 * matplotlib.colormaps["viridis"](1.0 - level)[..., :3]).astype(np.uint8)
    colors[depth_mm == 0] = 0
    return np.repeat(np.repeat(colors, _SCALE, axis=0), _SCALE, axis=1)


def montage(split: Path, count: int, columns: int = 4) -> Image.Image:
    """Show the first images of a split, from as many scenes as there are, each above its depth.

    Args:
        split: Folder of the split.
        count: Number of images.
        columns: Images per row.

    Returns:
        The montage.
    """
    scenes = scene_folders(split)
    shares = [len(part) for part in np.array_split(np.arange(count), min(len(scenes), count))]
    tiles: list[NDArray[np.uint8]] = []
    for scene, share in zip(scenes, shares, strict=False):
        data = load_scenes([scene], limit=share)
        for i in range(len(data)):
            title = f"{split.name}/{scene.name} image {i}"
            image = annotated(data.rgb[i], data.ee[i], data.tool[i], data.row(i), data.camera(i), title)
            tiles.append(np.vstack([image, depth_picture(data.depth_mm[i])]))
    columns = min(columns, len(tiles))
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    picture = Image.fromarray(np.vstack(rows))
    return picture.resize((picture.width * 3 // 5, picture.height * 3 // 5), Image.Resampling.LANCZOS)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the first images of each split of a data set into a folder."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.data_set", description="Draw a data set's labels.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="folder of the pictures (default: DIR-inspection)")
    parser.add_argument("--count", type=int, default=12, help="images of each split")
    asked = parser.parse_args(arguments)
    out = asked.out or asked.folder.with_name(f"{asked.folder.resolve().name}-inspection")
    out.mkdir(parents=True, exist_ok=True)
    for split in SPLITS:
        if scene_folders(asked.folder / split):
            montage(asked.folder / split, max(asked.count, 1)).save(out / f"montage_{split}.png")


if __name__ == "__main__":
    main()
