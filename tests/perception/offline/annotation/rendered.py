"""Clicks of a careful person on the frames of a rendered data set, from its meshes and true poses."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, transform_points
from toolee_robot.perception.offline.annotation.clicks import Click, ClickedEnd, Role, Shape

VISIBLE = 0.9
"""Share of the clicked points that must be in the visible mask."""
HAND = 0.7
"""Standard deviation of the clicks [px]."""


@dataclass(frozen=True)
class RenderedEnd:
    """An end effector that can be clicked: the frame's name, the clicks, the true pose and the visible mask's box."""

    name: str
    clicked: ClickedEnd
    X_camera_ee: Array
    box: tuple[float, float, float, float]


def rendered_ends(data: Path, split: str, seed: int = 0) -> Iterator[RenderedEnd]:
    """The hammer faces and screwdriver tips of a split's first scene that are seen well enough to be clicked."""
    rng = np.random.default_rng(seed)
    scene = data / split / "000000"
    truth, cameras = (json.loads((scene / f"scene_{n}.json").read_text()) for n in ("gt", "camera"))
    for key, entries in truth.items():
        K = np.array(cameras[key]["cam_K"]).reshape(3, 3)
        for k, entry in enumerate(entries):
            loaded = cv2.imread(str(scene / "mask_visib" / f"{int(key):06d}_{k:06d}.png"), cv2.IMREAD_GRAYSCALE)
            assert loaded is not None
            mask = np.asarray(loaded, np.uint8)
            X = np.eye(4)
            X[:3, :3], X[:3, 3] = np.reshape(entry["cam_R_m2c"], (3, 3)), np.array(entry["cam_t_m2c"]) / 1000
            mesh: Any = trimesh.load(data / "models" / f"obj_{entry['obj_id']:06d}.ply")
            category = CATEGORIES[entry["category_id"] - 1]
            made = {Category.HAMMER_HEAD: _face, Category.SCREWDRIVER_HEAD: _tip}.get(category)
            points = None if made is None else made(mesh, X, rng)
            if points is None or not _seen(points, X, K, mask, category):
                continue
            clicks, caliper = [], points.pop("caliper", None)
            for role, local in points.items():
                for u, v in _project(K, transform_points(X, local)):
                    clicks.append(Click(Role(role), *(np.array([u, v]) + rng.normal(0, HAND, 2)).tolist()))
            shape = Shape.FACE if category is Category.HAMMER_HEAD else Shape.TIP
            rows, columns = np.nonzero(mask)
            box = float(columns.min()), float(rows.min()), float(columns.max() + 1), float(rows.max() + 1)
            yield RenderedEnd(f"{int(key):06d}", ClickedEnd(shape, tuple(clicks), caliper), X, box)


def _face(mesh: Any, X: Array, rng: np.random.Generator) -> dict[str, Any] | None:
    """Rim and inside of a round face, from the vertices in its plane; None for another face, or one seen obliquely."""
    vertices = np.asarray(mesh.vertices) / 1000
    flat = vertices[np.abs(vertices[:, 2]) < 1e-5]
    edge = flat[ConvexHull(flat[:, :2]).vertices]
    size = np.linalg.norm(edge[:, :2], axis=1)
    facing = -X[:3, 2] @ X[:3, 3] / np.linalg.norm(X[:3, 3])
    if np.ptp(size) > 0.02 * size.max() or facing < np.cos(np.deg2rad(65)):
        return None
    r = float(size.mean())
    t = np.arange(8) * np.pi / 4 + rng.uniform(0, np.pi)
    ring = np.stack([np.cos(t), np.sin(t), 0 * t], 1)
    return {"rim": r * ring, "surface": 0.55 * r * ring[:6]}


def _tip(mesh: Any, X: Array, rng: np.random.Generator) -> dict[str, Any] | None:
    """Tip and shaft, where the shaft is a round rod of one diameter."""
    along = -X[:3, 2] @ X[:3, 3] / np.linalg.norm(X[:3, 3])
    if abs(along) > np.cos(np.deg2rad(25)):
        return None
    points, _ = trimesh.sample.sample_surface(mesh, 4000, seed=int(rng.integers(2**31)))
    points = np.asarray(points) / 1000
    back = points[(points[:, 2] < -0.015) & (points[:, 2] > -0.045)]
    radii = np.linalg.norm(back[:, :2], axis=1)
    if len(radii) < 20 or np.ptp(np.percentile(radii, (5, 95))) > 0.15 * radii.mean():
        return None
    z = -np.linspace(0.012, 0.045, 5)
    shaft = np.stack([0 * z, 0 * z, z], 1)
    return {"tip": np.zeros((2, 3)), "shaft": shaft, "caliper": 2000 * float(radii.mean())}


def _seen(points: dict[str, Any], X: Array, K: Array, mask: NDArray[np.uint8], category: Category) -> bool:
    every = np.vstack([p for role, p in points.items() if role != "caliper"])
    pixels = np.rint(_project(K, transform_points(X, every))).astype(int)
    height, width = mask.shape
    inside = (pixels >= 0).all(1) & (pixels < [width, height]).all(1)
    grown = cv2.dilate(mask, np.ones((3, 3), np.uint8))
    least = 100 if category is Category.HAMMER_HEAD else 30
    return bool((mask > 0).sum() > least and inside.all() and (grown[pixels[:, 1], pixels[:, 0]] > 0).mean() >= VISIBLE)


def _project(K: Array, points: Array) -> Array:
    return (points @ K.T)[:, :2] / points[:, 2:]
