"""Look at a data set: colour images with masks and EE axes (x red, y green, z blue; 4 cm long), depth below.

python -m toolee_robot.perception.dataset.inspect data/train montage.png --first 0 --count 12
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from toolee_robot.errors import TooleeError
from toolee_robot.perception.dataset.records import CATEGORIES, Example
from toolee_robot.perception.dataset.storage import load

_COLORS = np.array([(255, 60, 60), (255, 200, 0), (0, 220, 90), (60, 160, 255)], np.float32)
"""Of the categories, in their order."""


def annotated(example: Example) -> NDArray[np.uint8]:
    """(H, W, 3) uint8: the image, EEs tinted by category, tools outlined, EE axes drawn."""
    image = example.rgb.astype(np.float32)
    table, K = example.table, example.intrinsics
    tool = example.tool
    edge = np.zeros(tool.shape, bool)
    edge[1:] |= tool[1:] != tool[:-1]
    edge[:, 1:] |= tool[:, 1:] != tool[:, :-1]
    image[edge] = 255
    for row in np.flatnonzero(table.category):
        mask = example.ee == row + 1
        image[mask] = 0.5 * image[mask] + 0.5 * _COLORS[table.category[row] - 1]
    canvas = Image.fromarray(image.astype(np.uint8))
    draw = ImageDraw.Draw(canvas)
    for row in np.flatnonzero(table.category):
        X = table.X_camera_ee[row].astype(np.float64)
        ends = X[:3, 3] + np.vstack([np.zeros(3), 0.04 * X[:3, :3].T])
        if ends[:, 2].min() < 0.05:
            continue
        pixels = ends[:, :2] / ends[:, 2:] * [K.fx, K.fy] + [K.cx, K.cy]
        for axis, color in enumerate(("red", "lime", "blue")):
            draw.line([tuple(pixels[0]), tuple(pixels[axis + 1])], fill=color, width=2)
        text = f"{CATEGORIES[table.category[row] - 1]} {table.visible[row]}px {100 * table.occlusion[row]:.0f}%"
        draw.text((pixels[0][0] + 4, pixels[0][1] + 4), text, fill="white", stroke_width=1, stroke_fill="black")
    return np.asarray(canvas)


def depth_picture(depth_mm: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """(H, W, 3) uint8: near is bright, 2 m and beyond dark, unknown red."""
    grey = np.clip(255 - depth_mm.astype(np.float32) / 2000 * 230, 25, 255)
    out = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    out[depth_mm == 0] = (160, 0, 0)
    return out


def montage(examples: list[Example], columns: int = 4, depth: bool = True) -> NDArray[np.uint8]:
    """All examples in a grid, each over its depth."""
    tiles = [np.vstack([annotated(e), depth_picture(e.depth_mm)]) if depth else annotated(e) for e in examples]
    blank = np.zeros_like(tiles[0])
    tiles += [blank] * (-len(tiles) % columns)
    return np.vstack([np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)])


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=12)
    options = parser.parse_args()
    try:
        data = load(options.folder, depth=True, limit=options.first + options.count)
    except TooleeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    examples = [data.example(i) for i in range(options.first, len(data))]
    Image.fromarray(montage(examples)).save(options.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
