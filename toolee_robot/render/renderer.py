"""The renderer: embree finds the hits, numpy shades them. Deterministic, no OpenGL, no system library.

rendering = render(Scene([Body(box((0.1, 0.1, 0.1)), X_world_box)]), intrinsics, X_world_camera)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.render.caster import Caster, dot, unit
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.scene import Body, Rendering, Scene
from toolee_robot.types import CameraIntrinsics

_MIDDLE_GREY = 0.2
"""Linear brightness that automatic exposure aims at."""
_SUBPIXELS = ((-0.33, -0.17), (0.33, 0.17))
"""Further rays through a pixel on an outline [px from its centre]."""


def render(
    scene: Scene,
    intrinsics: CameraIntrinsics,
    X_world_camera: Array,
    antialias: bool = True,
    exposure: float = 1.0,
    auto_exposure: float = 0.0,
) -> Rendering:
    """Render the scene from a camera (OpenCV axes: x right, y down, z forward).

    antialias: shoot two more rays through each pixel on an outline (colour only; depth and ids stay those of the
    pixel's centre). exposure: factor on the linear colour before the sRGB curve.
    auto_exposure: in [0, 1], how much the camera makes up for a dark or bright scene.
    """
    return Shot(scene, intrinsics, X_world_camera).develop(antialias, exposure, auto_exposure)


class Shot:
    """A scene seen by a camera before it is shaded: depth (H, W) float32 [m] and body_ids (H, W) int16 as in
    `Rendering`. Whoever dislikes what is seen need not pay for the colours."""

    def __init__(self, scene: Scene, intrinsics: CameraIntrinsics, X_world_camera: Array) -> None:
        self._scene, self._intrinsics = scene, intrinsics
        self._caster = Caster(scene, X_world_camera)
        self._directions = _rays(intrinsics, (0, 0, intrinsics.width, intrinsics.height))
        depth, self._body, self._hits = self._caster.hits(self._directions)
        ids = np.array([b.body_id for b in scene.bodies] + [-1], np.int16)[self._body]  # body -1 takes the last entry
        grid = (intrinsics.height, intrinsics.width)
        self.depth, self.body_ids = depth.reshape(grid), ids.reshape(grid)

    def develop(self, antialias: bool = True, exposure: float = 1.0, auto_exposure: float = 0.0) -> Rendering:
        """Shade it; arguments as for `render`."""
        grid = (self._intrinsics.height, self._intrinsics.width)
        caster, hits = self._caster, self._hits
        color = _background(self._scene, caster, self._intrinsics, self._directions, self._body)
        lit, shiny = caster.shade(hits, grid)
        color[:, hits.ray] = lit
        cos = np.zeros(self.depth.size, np.float32)
        cos[hits.ray] = np.clip(dot(hits.normals, hits.views), 0.0, 1.0)
        shininess = np.zeros(self.depth.size, np.float32)
        shininess[hits.ray] = shiny
        if antialias:
            _smooth_outlines(caster, self._intrinsics, color, self.depth, self._body.reshape(grid))
        if auto_exposure > 0:
            mean = float(np.minimum(color, 1.0).mean())
            exposure *= float(np.clip((_MIDDLE_GREY / max(mean, 1e-3)) ** auto_exposure, 0.4, 6.0))
        return Rendering(
            rgb=np.ascontiguousarray(to_srgb(color * np.float32(exposure)).reshape(3, *grid).transpose(1, 2, 0)),
            depth=self.depth,
            body_ids=self.body_ids,
            cos_incidence=cos.reshape(grid),
            shininess=shininess.reshape(grid),
        )


def cast(
    bodies: Sequence[Body],
    intrinsics: CameraIntrinsics,
    X_world_camera: Array,
    region: tuple[int, int, int, int] | None = None,
) -> tuple[FloatArray, NDArray[np.int16]]:
    """depth [m] and body_ids as in `Rendering`, without colours, of the pixels x0 <= x < x1, y0 <= y < y1."""
    x0, y0, x1, y1 = region if region is not None else (0, 0, intrinsics.width, intrinsics.height)
    depth, body = Caster(Scene(bodies), X_world_camera).cast(_rays(intrinsics, (x0, y0, x1, y1)))
    ids = np.array([b.body_id for b in bodies] + [-1], np.int16)[body]
    return depth.reshape(y1 - y0, x1 - x0), ids.reshape(y1 - y0, x1 - x0)


def pixel_rays(intrinsics: CameraIntrinsics) -> FloatArray:
    """(H, W, 3) rays through the pixel centres, z = 1, camera frame."""
    u = ((np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx).astype(np.float32)
    v = ((np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy).astype(np.float32)
    rays = np.ones((intrinsics.height, intrinsics.width, 3), np.float32)
    rays[..., 0] = u
    rays[..., 1] = v[:, None]
    return rays


def _rays(intrinsics: CameraIntrinsics, region: tuple[int, int, int, int]) -> FloatArray:
    """(3, N) rays through the centres of the pixels x0 <= x < x1, y0 <= y < y1, z = 1, camera frame."""
    x0, y0, x1, y1 = region
    return np.ascontiguousarray(pixel_rays(intrinsics)[y0:y1, x0:x1].reshape(-1, 3).T)


def to_srgb(linear: FloatArray) -> NDArray[np.uint8]:
    """Linear RGB to 8-bit sRGB, highlights rolled off softly above 0.8."""
    x = np.maximum(linear, 0.0)
    bright = x > 0.8
    x[bright] = 1.0 - 0.2 * np.exp(-(x[bright] - 0.8) / 0.2)
    return _SRGB.take((x * np.float32(4095)).astype(np.int32))


def _srgb_table() -> NDArray[np.uint8]:
    x = np.arange(4096) / 4095
    y = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.round(255 * y).astype(np.uint8)


_SRGB = _srgb_table()


def _background(
    scene: Scene, caster: Caster, intrinsics: CameraIntrinsics, directions: FloatArray, body: NDArray[np.int32]
) -> FloatArray:
    """(3, H*W) linear colour where nothing is hit (body -1); anything elsewhere."""
    if scene.background is not None:
        shape = (intrinsics.height, intrinsics.width, 3)
        if scene.background.shape != shape:
            raise ValueError(f"background is {scene.background.shape}, the camera's image is {shape}")
        return np.ascontiguousarray(scene.background.reshape(-1, 3).T, np.float32)
    color = np.empty_like(directions)
    missed = np.flatnonzero(body < 0)
    color[:, missed] = _surroundings(caster, directions[:, missed])
    return color


def _surroundings(caster: Caster, directions: FloatArray) -> FloatArray:
    """(3, N) what the environment looks like along rays (3, N)."""
    return caster.environment.specular(unit(caster.R_world_camera @ directions), 0.0)


def _smooth_outlines(
    caster: Caster, intrinsics: CameraIntrinsics, color: FloatArray, depth: FloatArray, body: NDArray[np.int32]
) -> None:
    """Replace the colour of pixels on outlines (in place) by the mean over the centre's ray and two more."""
    edge = np.zeros(body.shape, bool)
    for axis in (0, 1):
        a = [slice(None)] * 2
        b = [slice(None)] * 2
        a[axis], b[axis] = slice(1, None), slice(None, -1)
        da, db = depth[tuple(a)], depth[tuple(b)]
        step = (body[tuple(a)] != body[tuple(b)]) | (np.abs(da - db) > 0.02 * np.minimum(da, db))
        edge[tuple(a)] |= step
        edge[tuple(b)] |= step
    pixels = np.flatnonzero(edge)
    if not len(pixels):
        return
    rows, columns = np.divmod(pixels, intrinsics.width)
    u = np.concatenate([columns + du for du, _ in _SUBPIXELS])
    v = np.concatenate([rows + dv for _, dv in _SUBPIXELS])
    rays = np.ones((3, len(u)), np.float32)
    rays[0], rays[1] = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    _, found, hits = caster.hits(rays)
    if caster.scene.background is not None:
        background = caster.scene.background[rows, columns].astype(np.float32, copy=False).T
        samples = np.concatenate([background] * len(_SUBPIXELS), axis=1)
    else:
        samples = np.empty_like(rays)
        missed = np.flatnonzero(found < 0)
        samples[:, missed] = _surroundings(caster, rays[:, missed])
    samples[:, hits.ray] = caster.shade(hits, None)[0]
    total = color[:, pixels] + samples.reshape(3, len(_SUBPIXELS), -1).sum(axis=1)
    color[:, pixels] = total / (1 + len(_SUBPIXELS))
