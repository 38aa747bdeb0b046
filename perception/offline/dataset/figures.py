"""Pictures of a data set: a montage with its labels, and the shape distances of the paper's Fig. 3.

Fig. 3: do tools of a category resemble each other more at their end effectors than as whole objects? Pairs of
instances are compared in the objects' own frames: whole tools in the tool's, end effectors in the EE's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.perception.offline.dataset.index_files import CARD, is_finished
from toolee_robot.perception.offline.dataset.instances import MODELS, model_path, read_ply, tool_path
from toolee_robot.perception.offline.dataset.records import EeTable, FloatArray, read_json
from toolee_robot.perception.offline.dataset.scenes import load_scenes, scene_folders
from toolee_robot.perception.offline.dataset.spec import SPLITS, DatasetSpec
from toolee_robot.runtime.files import json_line, write_atomic
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
        name = CATEGORIES[table.category[row] - 1].spec.label
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


POINTS = 512
PAIRS = 100
MEASURES = ("chamfer", "hausdorff", "earth_mover")
VIEWS = ("object", "ee")


def inspect(root: Path, out: Path, count: int, pairs: int) -> dict[str, Any]:
    """Draw a data set into a folder: montage_train.png, montage_test.png, shapes.png, inspection.json.

    Args:
        root: Folder of the data set.
        out: Folder of the pictures.
        count: Images of each split in the montage.
        pairs: Pairs of instances per category in Fig. 3.

    Returns:
        Content of inspection.json: specification, counts by split and category, shape distances.

    Raises:
        UserError: There is no data set, or it is not finished.
        AssetError: A file is missing or damaged.
    """
    spec = DatasetSpec.read(root)
    if not is_finished(root):
        raise UserError(f"{root} is not finished: run its `toolee dataset generate` again")
    out.mkdir(parents=True, exist_ok=True)
    for split in SPLITS:
        if scene_folders(root / split):
            montage(root / split, count).save(out / f"montage_{split}.png")
    found = shape_distances(root, pairs)
    if found.values:
        shape_figure(found).savefig(out / "shapes.png", dpi=110)
    splits = _summary(read_json(root / CARD))
    record = {"spec": spec.to_json(), "splits": splits, "shape_distances": found.to_json()}
    write_atomic(out / "inspection.json", (json_line(record) + "\n").encode())
    return record


def _summary(card: dict[str, Any]) -> dict[str, Any]:
    return {
        split: {
            "examples": part["examples"],
            "categories": {
                c: {"targets": about["targets"], "instances": len(about["instances"])}
                for c, about in part["categories"].items()
            },
        }
        for split, part in card["splits"].items()
    }


@dataclass(frozen=True)
class ShapeDistances:
    """Distances between the instances of each category.

    Attributes:
        values: values[category][view][measure]: the distances of P pairs, (P,) [mm]; the views are "object" and "ee".
    """

    values: dict[str, dict[str, dict[str, Array]]]

    def to_json(self) -> dict[str, object]:
        """Mean, variance and number of pairs."""
        return {
            category: {
                view: {
                    m: {"mean_mm": float(v.mean()), "variance_mm2": float(v.var()), "pairs": len(v)}
                    for m, v in by.items()
                }
                for view, by in views.items()
            }
            for category, views in self.values.items()
        }


def distances(a: Array, b: Array) -> tuple[float, float, float]:
    """Distances between two clouds of equal size.

    Args:
        a: A cloud, (N, 3).
        b: The other cloud, (N, 3).

    Returns:
        Chamfer distance (mean of both directions' mean nearest distances), Hausdorff distance and Earth mover's
        distance (mean over the best one-to-one matching), in the unit of the clouds.
    """
    d = cdist(a, b)
    ab, ba = d.min(axis=1), d.min(axis=0)
    rows, columns = linear_sum_assignment(d)
    return float((ab.mean() + ba.mean()) / 2), float(max(ab.max(), ba.max())), float(d[rows, columns].mean())


def shape_distances(root: Path, pairs: int = PAIRS, seed: int = 0) -> ShapeDistances:
    """Compare random pairs of a category's instances in a data set.

    Args:
        root: Folder of the data set.
        pairs: Largest number of pairs per category.
        seed: Seed of the choice.

    Returns:
        The distances; without the categories of which the data set shows fewer than two instances.

    Raises:
        AssetError: A file is missing or damaged.
    """
    info = read_json(root / MODELS / "models_info.json")
    values: dict[str, dict[str, dict[str, Array]]] = {}
    for category in map(str, CATEGORIES):
        objects: dict[str, int] = {}
        for obj_id, entry in info.items():
            if entry["category"] == category:
                objects.setdefault(entry["instance"], int(obj_id))
        names = sorted(objects)
        possible = list(combinations(range(len(names)), 2))
        if not possible:
            continue
        rng = np.random.default_rng(seed)
        chosen = rng.permutation(len(possible))[:pairs]
        clouds = {
            "object": [_sampled(tool_path(root, name)) for name in names],
            "ee": [_sampled(model_path(root, objects[name])) for name in names],
        }
        values[category] = {}
        for view in VIEWS:
            rows = np.array([distances(clouds[view][possible[k][0]], clouds[view][possible[k][1]]) for k in chosen])
            values[category][view] = {m: rows[:, i] for i, m in enumerate(MEASURES)}
    return ShapeDistances(values)


def _sampled(path: Path) -> Array:
    """(512, 3) points [mm], uniform on a mesh."""
    vertices, faces = read_ply(path)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(mesh, POINTS, seed=1)[0], np.float64)


_TITLES = {"chamfer": "Chamfer", "hausdorff": "Hausdorff", "earth_mover": "Earth-Mover's"}


def shape_figure(shapes: ShapeDistances) -> Figure:
    """Fig. 3: distances within each category, object-centric against EE-centric: boxes, means as diamonds."""
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(MEASURES))
    names = list(shapes.values)
    for ax, measure in zip(axes, MEASURES, strict=True):
        for view, offset, color in zip(VIEWS, (-0.2, 0.2), ("0.65", "tab:green"), strict=True):
            boxes = ax.boxplot(
                [shapes.values[n][view][measure] for n in names],
                positions=np.arange(len(names)) + offset,
                widths=0.34,
                patch_artist=True,
                showmeans=True,
                flierprops={"markersize": 2},
                medianprops={"color": "black"},
                meanprops={"marker": "D", "markerfacecolor": "white", "markeredgecolor": "black", "markersize": 4},
            )
            for box in boxes["boxes"]:
                box.set_facecolor(color)
        ax.set_xticks(np.arange(len(names)), [n.replace("_", "\n") for n in names])
        ax.set_title(f"{_TITLES[measure]} distance [mm]", fontsize=10)
        ax.set_ylim(bottom=0)
    patches = [Patch(facecolor=color, edgecolor="black") for color in ("0.65", "tab:green")]
    axes[0].legend(patches, ["object-centric", "EE-centric"], frameon=False)
    return figure
