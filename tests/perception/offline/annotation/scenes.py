"""Flat ends and shafts before a wall, seen by a noisy depth camera, and the clicks of a person on them.

The geometry is written here from the frames' definitions (docs/concepts/frames.md), not from the fitted models.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from toolee_robot.depth_noise import AXIAL_MM, COMMON, SYSTEMATIC, DepthNoise
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, frame_from_axes, transform_points
from toolee_robot.perception.offline.annotation.clicks import Click, ClickedEnd, Role, Shape
from toolee_robot.perception.offline.annotation.measurements import CLICK
from toolee_robot.types import CameraIntrinsics, RgbdFrame

CAMERA = CameraIntrinsics(365.5, 365.5, 254.9, 205.4, 512, 424)
WALL = 1.6
"""Depth of the wall [m]."""
HAND = CLICK
"""Standard deviation of a person's click [px]."""


@dataclass(frozen=True)
class Scene:
    """A frame, the clicks on its end, and the end's true pose."""

    frame: RgbdFrame
    end: ClickedEnd
    X_camera_ee: Array


def project(points: Array) -> Array:
    return CAMERA.fx * points[..., :2] / points[..., 2:] + [CAMERA.cx, CAMERA.cy]


def _pose(
    rng: np.random.Generator, steepest: float, farthest: float = 0.9, seen: tuple[float, float, float] = (0, 0, 0)
) -> Array:
    """A pose before the camera, its z towards it within an angle [deg], that has a point of the EE frame in view."""
    while True:
        p = np.array([rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), rng.uniform(0.4, farthest)])
        tilt, turn = np.deg2rad(rng.uniform(0, steepest)), rng.uniform(0, 2 * np.pi)
        to_camera = frame_from_axes(z=-p, x=np.array([1.0, 0.0, 0.0]))[:3, :3]
        z = to_camera @ [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
        X = frame_from_axes(z=z, x=Rotation.random(random_state=rng).as_matrix()[0], p=p)
        point = transform_points(X, np.array([seen]))[0]
        u, v = project(point)
        if point[2] > 0.3 and 15 < u < CAMERA.width - 15 and 15 < v < CAMERA.height - 15:
            return X


def _noisy(rng: np.random.Generator, depth: Array, cosine: Array) -> Array:
    """The sensor of `depth_noise`, without lost pixels: axial noise, in part common to neighbours, and a bias."""
    a, b, c, d = AXIAL_MM
    theta = np.arccos(np.clip(cosine, 0.0, 1.0))
    sigma = 1e-3 * (a + b * depth + c * depth**2 + d * depth**1.5 * (theta / (np.pi / 2 - theta + 1e-9)) ** 2)
    share = DepthNoise.correlation
    blurred = gaussian_filter(rng.normal(size=depth.shape), COMMON)
    blurred *= 2 * np.sqrt(np.pi) * COMMON
    noise = np.sqrt(1 - share) * rng.normal(size=depth.shape) + np.sqrt(share) * blurred
    return depth * (1 + rng.normal(0, SYSTEMATIC)) + rng.normal(0, SYSTEMATIC) + sigma * noise


def _seen(
    rng: np.random.Generator,
    X_camera_plane: Array,
    inside: Callable[[Array, Array], NDArray[np.bool_]],
    *,
    handle: Array | None,
) -> RgbdFrame:
    """A flat thing in the xy plane of a frame before a wall, and a disc about the handle's end."""
    v, u = np.indices((CAMERA.height, CAMERA.width))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    n, p = X_camera_plane[:3, 2], X_camera_plane[:3, 3]
    z = (n @ p) / (rays @ n)
    local = (rays * z[..., None] - p) @ X_camera_plane[:3, :3]
    on = inside(local[..., 0], local[..., 1])
    depth, cosine = np.full(u.shape, WALL), np.ones(u.shape)
    depth[on] = z[on]
    cosine[on] = np.abs(rays @ n / np.linalg.norm(rays, axis=2))[on]
    if handle is not None:
        away = (np.linalg.norm(rays * handle[2] - handle, axis=2) < 0.012) & (depth > handle[2])
        depth[away], cosine[away] = handle[2], 1.0
    rgb = np.where(on[..., None], 200, 60).astype(np.uint8) * np.ones(3, np.uint8)
    return RgbdFrame(rgb, _noisy(rng, depth, cosine).astype(np.float32), CAMERA)


def clicked(rng: np.random.Generator, role: Role, points: Array, hand: float = HAND) -> list[Click]:
    """Clicks on points (N, 3) [m] in the camera frame."""
    pixels = project(np.atleast_2d(points))
    return [Click(role, float(u), float(v)) for u, v in pixels + rng.normal(0, hand, pixels.shape)]


def _disc(rng: np.random.Generator, n: int, inner: float, outer: float) -> Array:
    """Points (n, 3) of a ring, spread about its axis."""
    t = rng.uniform(0, 2 * np.pi) + np.arange(n) * 2 * np.pi / n + rng.uniform(-0.2, 0.2, n)
    r = rng.uniform(inner, outer, n)
    return np.stack([r * np.cos(t), r * np.sin(t), np.zeros(n)], 1)


def face(rng: np.random.Generator, *, caliper: bool = False, handle: bool = True) -> Scene:
    """A round striking face of 24 to 40 mm diameter."""
    far = (0.15, 0.0, -0.05)
    X, radius = _pose(rng, 60.0, seen=far), rng.uniform(0.012, 0.020)
    butt = transform_points(X, np.array([far]))[0]
    frame = _seen(rng, X, lambda x, y: np.hypot(x, y) < radius, handle=butt if handle else None)
    rim = transform_points(X, _disc(rng, 8, radius, radius))
    inside = transform_points(X, _disc(rng, 6, 0.2 * radius, 0.65 * radius))
    clicks = clicked(rng, Role.RIM, rim) + clicked(rng, Role.SURFACE, inside)
    clicks += clicked(rng, Role.HANDLE, butt) if handle else []
    return Scene(frame, ClickedEnd(Shape.FACE, tuple(clicks), 2000 * radius if caliper else None), X)


def ring(rng: np.random.Generator) -> Scene:
    """A ring of a wrench, its nut's centre in the middle of its thickness."""
    X, hole, thickness = _pose(rng, 50.0, seen=(0.15, 0.0, 0.0)), rng.uniform(0.008, 0.012), rng.uniform(0.006, 0.014)
    X_top = X.copy()
    X_top[:3, 3] += 0.5 * thickness * X[:3, 2]
    outer = hole + rng.uniform(0.008, 0.012)
    far = transform_points(X, np.array([[0.15, 0.0, 0.0]]))[0]

    def inside(x: Array, y: Array) -> NDArray[np.bool_]:
        return (np.hypot(x, y) < outer) & (np.hypot(x, y) > hole)

    frame = _seen(rng, X_top, inside, handle=far)
    rim = transform_points(X_top, _disc(rng, 8, hole, hole))
    surface = transform_points(X_top, _disc(rng, 6, 0.5 * (hole + outer), 0.5 * (hole + outer)))
    clicks = clicked(rng, Role.RIM, rim) + clicked(rng, Role.SURFACE, surface) + clicked(rng, Role.HANDLE, far)
    return Scene(frame, ClickedEnd(Shape.RING, tuple(clicks), 1000 * thickness), X)


def _slotted(rng: np.random.Generator, shape: Shape) -> Scene:
    """A plate with a slot along x, its origin in the slot's middle; the handle lies along -x, a claw's behind it."""
    handle_end = (-0.15, 0.0, -0.05 if shape is Shape.CLAW else 0.0)
    X, thickness = _pose(rng, 50.0, seen=handle_end), rng.uniform(0.004, 0.010)
    length, gap, width = rng.uniform(0.018, 0.030), rng.uniform(0.005, 0.008), rng.uniform(0.022, 0.028)
    X_top = X.copy()
    X_top[:3, 3] += 0.5 * thickness * X[:3, 2]
    longer = rng.uniform(0.0, 0.006) if shape is Shape.OPEN_JAW else 0.0  # one flat may be longer

    def inside(x: Array, y: Array) -> NDArray[np.bool_]:
        end = 0.5 * length + np.where(y > 0, longer, 0.0)
        plate = (np.abs(y) < width) & (x > -length) & (x < end)
        return plate & ~((np.abs(y) < gap) & (x > -0.5 * length))

    at = {
        Role.THROAT: [-0.5 * length, 0.0, 0.0],
        Role.END_A: [0.5 * length + longer, gap, 0.0],
        Role.END_B: [0.5 * length, -gap, 0.0],
    }
    y = 0.5 * (gap + width)
    surface = [[x * length, s * y, 0.0] for x in (-0.25, 0.0, 0.25) for s in (-1, 1)]
    handle = transform_points(X, np.array([handle_end]))[0]
    if shape is Shape.OPEN_JAW:  # x points to the handle
        X = X @ np.diag([-1.0, -1.0, 1.0, 1.0])
    frame = _seen(rng, X_top, inside, handle=handle)
    clicks = clicked(rng, Role.SURFACE, transform_points(X_top, np.array(surface)))
    for role, point in at.items():
        clicks += clicked(rng, role, transform_points(X_top, np.array([point] * 2)))
    clicks += clicked(rng, Role.HANDLE, handle)
    return Scene(frame, ClickedEnd(shape, tuple(clicks), 1000 * thickness), X)


def open_jaw(rng: np.random.Generator) -> Scene:
    """An open jaw, one flat longer than the other."""
    return _slotted(rng, Shape.OPEN_JAW)


def claw(rng: np.random.Generator) -> Scene:
    """A flat claw."""
    return _slotted(rng, Shape.CLAW)


def tip(rng: np.random.Generator) -> Scene:
    """A screwdriver's shaft of 6 to 10 mm diameter, a round rod."""
    radius = rng.uniform(0.003, 0.005)
    X = _pose(rng, 60.0, 0.5)
    lying = frame_from_axes(z=X[:3, 0], x=X[:3, 2], p=X[:3, 3])
    d, end, length = lying[:3, 2], lying[:3, 3], 0.09
    v, u = np.indices((CAMERA.height, CAMERA.width))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    across, offset = rays - (rays @ d)[..., None] * d, -end + (end @ d) * d
    a, b, c = (across**2).sum(-1), across @ offset, offset @ offset - radius**2
    inside = b**2 - a * c
    z = np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
    along = (rays * np.where(np.isfinite(z), z, 0.0)[..., None] - end) @ d
    on = np.isfinite(z) & (along < 0) & (along > -length)
    depth = np.where(on, z, WALL)
    frame = RgbdFrame(
        np.where(on[..., None], 200, 60).astype(np.uint8) * np.ones(3, np.uint8),
        _noisy(rng, depth, np.ones(u.shape)).astype(np.float32),
        CAMERA,
    )
    shaft = end - np.linspace(0.01, 0.08, 5)[:, None] * d
    clicks = clicked(rng, Role.TIP, np.stack([end, end])) + clicked(rng, Role.SHAFT, shaft)
    return Scene(frame, ClickedEnd(Shape.TIP, tuple(clicks), 2000 * radius), lying)


VISIBLE = 0.9
"""Share of the clicked points that must be in the visible mask."""
HAND_RENDERED = 0.7
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
            if points is None or not _seen_of_rendered(points, X, K, mask, category):
                continue
            clicks, caliper = [], points.pop("caliper", None)
            for role, local in points.items():
                for u, v in _project(K, transform_points(X, local)):
                    clicks.append(Click(Role(role), *(np.array([u, v]) + rng.normal(0, HAND_RENDERED, 2)).tolist()))
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


def _seen_of_rendered(points: dict[str, Any], X: Array, K: Array, mask: NDArray[np.uint8], category: Category) -> bool:
    every = np.vstack([p for role, p in points.items() if role != "caliper"])
    pixels = np.rint(_project(K, transform_points(X, every))).astype(int)
    height, width = mask.shape
    inside = (pixels >= 0).all(1) & (pixels < [width, height]).all(1)
    grown = cv2.dilate(mask, np.ones((3, 3), np.uint8))
    least = 100 if category is Category.HAMMER_HEAD else 30
    return bool((mask > 0).sum() > least and inside.all() and (grown[pixels[:, 1], pixels[:, 0]] > 0).mean() >= VISIBLE)


def _project(K: Array, points: Array) -> Array:
    return (points @ K.T)[:, :2] / points[:, 2:]
