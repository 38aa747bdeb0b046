"""Dense surface samples of tools and hands, of which the synthetic clouds are made.

numpy only, in several processes.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, inverse
from toolee_robot.perception.offline.processes import WorkerPool
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.tools.catalog import TOOL_SPECS, make_tool, test_seeds, train_seeds
from toolee_robot.tools.model import ToolKind

EE_SAMPLES = 8192
REST_SAMPLES = 4096
HAND_SAMPLES = 6144
REGION = 1.15
"""Samples belong to the EE up to this factor of its radius; only those are dense."""

NOWHERE = 1e3
"""Distance [m] of the stand-in for the missing other end of a tool with one end."""

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class SurfaceSamples:
    """One row per EE of a tool, I in all; all in the EE's frame [m].

    Attributes:
        ee_points: Surface points near the EE, (I, 8192, 3).
        ee_normals: Their normals, (I, 8192, 3).
        asymmetric: Whether a point shows the spin, (I, 8192) bool.
        rest: The tool's other surface points, (I, 4096, 3).
        X_ee_tool: (I, 4, 4).
        category: Index into `Category`, (I,).
        other_end: Origin of the tool's other EE, (I, 3); 1 km away if it has none.
        other_category: Category of the other EE, (I,).
        handle: z_min, z_max and radius of the handle, tool frame, (I, 3).
        shininess: In [0, 1], (I,).
        names: "tool/category" of each row.
    """

    ee_points: Float32
    ee_normals: Float32
    asymmetric: NDArray[np.bool_]
    rest: Float32
    X_ee_tool: Float32
    category: NDArray[np.int64]
    other_end: Float32
    other_category: NDArray[np.int64]
    handle: Float32
    shininess: Float32
    names: tuple[str, ...]

    @property
    def tools(self) -> NDArray[np.int64]:
        """Index of the tool that each EE belongs to, (I,)."""
        names = [name.rsplit("/", 1)[0] for name in self.names]
        numbers = {name: i for i, name in enumerate(dict.fromkeys(names))}
        return np.array([numbers[name] for name in names], np.int64)


def _rows(job: tuple[ToolKind, int]) -> list[dict[str, Any]]:
    """A tool's rows of `SurfaceSamples`, its fields by name."""
    kind, seed = job
    tool = make_tool(kind, seed)
    rng = np.random.default_rng([seed, TOOL_SPECS[kind].number, 7])
    points, normals, parts = tool.sample_surface(60_000, rng)
    shininess = np.array([part.material.metallic * (1 - part.material.roughness) for part in tool.parts])[parts]
    rows = []
    for ee in tool.ees:
        X_ee_tool = inverse(ee.X_tool_ee)
        other = next((e for e in tool.ees if e is not ee), None)
        p = points @ X_ee_tool[:3, :3].T + X_ee_tool[:3, 3]
        n = normals @ X_ee_tool[:3, :3].T
        near = np.linalg.norm(p, axis=1) < REGION * ee.category.spec.radius
        ee_pick = rng.choice(np.flatnonzero(near), EE_SAMPLES, replace=bool(near.sum() < EE_SAMPLES))
        rest = np.flatnonzero(~near)
        rest_pick = rng.choice(rest, REST_SAMPLES, replace=bool(len(rest) < REST_SAMPLES))
        tells = np.array([part.label in ee.category.spec.spin_cues for part in tool.parts])[parts[ee_pick]]
        radius = tool.handle.grip_radius
        other_end = np.full(3, NOWHERE) if other is None else (X_ee_tool @ other.X_tool_ee)[:3, 3]
        rows.append(
            {
                "ee_points": p[ee_pick].astype(np.float32),
                "ee_normals": n[ee_pick].astype(np.float32),
                "asymmetric": tells,
                "rest": p[rest_pick].astype(np.float32),
                "X_ee_tool": X_ee_tool.astype(np.float32),
                "category": np.int64(ee.category.spec.class_id - 1),
                "other_end": other_end.astype(np.float32),
                "other_category": np.int64((other or ee).category.spec.class_id - 1),
                "handle": np.array([tool.handle.z_min, tool.handle.z_max, radius], np.float32),
                "shininess": np.float32(shininess[ee_pick].mean()),
                "names": f"{tool.name}/{ee.category}",
            }
        )
    return rows


def sample_tools(held_out: bool, seeds_per_kind: int, workers: int | None = None) -> SurfaceSamples:
    """Sample tools of every kind.

    Args:
        held_out: Whether to take tools of the test split instead of the training split.
        seeds_per_kind: Tools per kind, times `ToolSpec.training_share`.
        workers: Processes; None: one per CPU; 1: this one.

    Returns:
        The samples.
    """
    seeds = test_seeds if held_out else train_seeds
    jobs = [(kind, seed) for kind, spec in TOOL_SPECS.items() for seed in seeds(seeds_per_kind * spec.training_share)]
    workers = workers or min(os.cpu_count() or 1, 16)
    if workers > 1 and len(jobs) > 64:
        with WorkerPool(workers) as pool:
            results = list(pool.map(_rows, jobs, chunksize=8))
    else:
        results = [_rows(job) for job in jobs]
    rows = [row for of_tool in results for row in of_tool]
    names = tuple(row.pop("names") for row in rows)
    return SurfaceSamples(names=names, **{name: np.stack([row[name] for row in rows]) for name in rows[0]})


def sample_hands(count: int = 64, seed: int = 0) -> Float32:
    """Sample the Shadow Hand closed around handles of many radii, with single fingers displaced.

    Args:
        count: Number of postures.
        seed: Seed of the postures.

    Returns:
        Points (count, 6144, 3) [m], `hand` frame.
    """
    rng = np.random.default_rng(seed)
    meshes = SHADOW_HAND.meshes
    areas = np.array([mesh.area for mesh in meshes.values()])
    # Fingers and palm occlude the tool, the forearm seldom does.
    weights = areas * np.array([0.3 if name in SHADOW_HAND.forearm else 1.0 for name in meshes])
    share = np.maximum(np.floor(weights / weights.sum() * HAND_SAMPLES).astype(int), 8)
    local = {
        name: _sample_mesh(mesh.vertices.view(np.ndarray), mesh.faces.view(np.ndarray), 4 * n, rng)
        for (name, mesh), n in zip(meshes.items(), share, strict=True)
    }
    half, closed = (SHADOW_HAND.posture(name) for name in ("preshape", "closed"))
    hands = np.empty((count, HAND_SAMPLES, 3), np.float32)
    for i in range(count):
        q = half + rng.uniform(0.3, 1.0) * (closed - half)
        q = q + rng.normal(0.0, 0.12, len(q)) * (np.abs(closed - half) > 0.01)
        poses = SHADOW_HAND.link_poses(q)
        cloud = np.concatenate(
            [
                local[name][rng.choice(4 * n, n, replace=False)] @ poses[name][:3, :3].T + poses[name][:3, 3]
                for name, n in zip(meshes, share, strict=True)
            ]
        )
        hands[i] = cloud[rng.choice(len(cloud), HAND_SAMPLES, replace=len(cloud) < HAND_SAMPLES)]
    return hands


def random_grasps(handle: Float32, rng: np.random.Generator, shift: float = 0.05) -> Float32:
    """Random grasps of handles: displaced, rotated about the handle, tilted, and sometimes reversed.

    Args:
        handle: z_min, z_max and radius of each handle, (B, 3) [m].
        rng: Random numbers.
        shift: Largest displacement along the handle [m].

    Returns:
        X_tool_hand, (B, 4, 4).
    """
    B = len(handle)
    # The nominal grasp is linear in the handle's radius.
    thin, thick = SHADOW_HAND.grasp.X_hand_tool(0.0), SHADOW_HAND.grasp.X_hand_tool(1.0)
    X_tool_hand = inverse(thin + handle[:, 2, None, None].astype(np.float64) * (thick - thin))
    about = np.where(rng.random(B) < 0.6, rng.normal(0, np.deg2rad(20), B), rng.uniform(-np.pi, np.pi, B))
    turn = Rotation.from_rotvec(about[:, None] * [0.0, 0.0, 1.0])
    tilt = Rotation.from_rotvec(np.column_stack([rng.normal(0, np.deg2rad(8), (B, 2)), np.zeros(B)]))
    flip = Rotation.from_rotvec(np.where(rng.random(B) < 0.12, np.pi, 0.0)[:, None] * [1.0, 0.0, 0.0])
    X: Array = np.tile(np.eye(4), (B, 1, 1))
    X[:, :3, :3] = (turn * tilt * flip).as_matrix()
    X[:, 2, 3] = np.clip(rng.uniform(-shift, shift, B), handle[:, 0] + 0.03, np.maximum(handle[:, 1], 0.0))
    return (X @ X_tool_hand).astype(np.float32)


def _sample_mesh(vertices: Array, faces: NDArray[np.int64], n: int, rng: np.random.Generator) -> Array:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    f = rng.choice(len(faces), n, p=area / area.sum())
    r, s = np.sqrt(rng.random((n, 1))), rng.random((n, 1))
    return np.asarray((1 - r) * a[f] + r * (1 - s) * b[f] + r * s * c[f])
