"""Flat ends and shafts before a wall, seen by a noisy depth camera, and the clicks of a person on them.

The geometry is written here from the frames' definitions (docs/concepts/frames.md), not from the fitted models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from toolee_robot.depth_noise import AXIAL_MM, COMMON, SYSTEMATIC, DepthNoise
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
