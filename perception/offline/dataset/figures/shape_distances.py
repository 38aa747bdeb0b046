"""The paper's Fig. 3: do tools of a category resemble each other more at their end effectors than as whole objects?

Pairs of instances, surfaces sampled alike, in the objects' own frames: object-centric is the whole tool in the tool's
frame, EE-centric its EE in the EE's frame. Distances in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import trimesh
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.frames import Array
from toolee_robot.perception.offline.dataset.instances import MODELS, model_path, read_ply, tool_path
from toolee_robot.perception.offline.dataset.scene_reader import read_json

POINTS = 512
PAIRS = 100
MEASURES = ("chamfer", "hausdorff", "earth_mover")
VIEWS = ("object", "ee")


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
