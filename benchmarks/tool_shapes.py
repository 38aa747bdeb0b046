"""How alike tools are as whole objects and at their end effectors: the paper's Fig. 3, of a data set.

    python -m benchmarks.tool_shapes DIR [--pairs 100] [--out shapes.png]

Pairs of instances are compared in the objects' own frames: whole tools in the tool's, end effectors in the EE's.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from toolee_robot.end_effectors import CATEGORIES, label_of
from toolee_robot.frames import Array
from toolee_robot.perception.offline.dataset.instances import MODELS, model_path, read_ply, tool_path
from toolee_robot.perception.offline.dataset.records import read_json

POINTS = 512
PAIRS = 100
MEASURES = ("chamfer", "hausdorff", "earth_mover")
VIEWS = ("object", "ee")
Shapes = dict[str, dict[str, dict[str, Array]]]
"""Distances of P pairs of a category, view and measure, (P,) [mm]; the views are "object" and "ee"."""


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


def shape_distances(root: Path, pairs: int = PAIRS, seed: int = 0) -> Shapes:
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
    return values


def _sampled(path: Path) -> Array:
    """(512, 3) points [mm], uniform on a mesh."""
    vertices, faces = read_ply(path)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(mesh, POINTS, seed=1)[0], np.float64)


_TITLES = {"chamfer": "Chamfer", "hausdorff": "Hausdorff", "earth_mover": "Earth-Mover's"}


def shape_figure(shapes: Shapes) -> Figure:
    """Fig. 3: distances within each category, of whole tools and of working ends: boxes, means as diamonds."""
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(MEASURES))
    names = list(shapes)
    for ax, measure in zip(axes, MEASURES, strict=True):
        for view, offset, color in zip(VIEWS, (-0.2, 0.2), ("0.65", "tab:green"), strict=True):
            boxes = ax.boxplot(
                [shapes[n][view][measure] for n in names],
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
        ax.set_xticks(np.arange(len(names)), [label_of(n).replace(" ", "\n") for n in names])
        ax.set_title(f"{_TITLES[measure]} distance [mm]", fontsize=10)
        ax.set_ylim(bottom=0)
    patches = [Patch(facecolor=color, edgecolor="black") for color in ("0.65", "tab:green")]
    axes[0].legend(patches, ["whole tool", "working end (EE)"], frameon=False)
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and draw the figure."""
    parser = argparse.ArgumentParser(description="Compare the tools of a data set by their shapes.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pairs", type=int, default=PAIRS)
    parser.add_argument("--out", type=Path, default=Path("shapes.png"))
    asked = parser.parse_args(arguments)
    found = shape_distances(asked.folder, asked.pairs)
    print("| category |", *(f"{_TITLES[measure]}: tool, EE [mm] |" for measure in MEASURES))
    print(f"|{'---|' * (1 + len(MEASURES))}")
    for category, views in found.items():
        cells = [", ".join(f"{views[view][measure].mean():.1f}" for view in VIEWS) for measure in MEASURES]
        print(f"| {label_of(category)} | {' | '.join(cells)} |")
    if found:
        shape_figure(found).savefig(asked.out, dpi=110)


if __name__ == "__main__":
    main()
