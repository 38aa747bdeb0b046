"""The renderer: embree finds the hits, numpy shades them. Deterministic, no OpenGL, no system library.

rendering = render(Scene([Body(box((0.1, 0.1, 0.1)), X_world_box)]), intrinsics, X_world_camera)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.render.caster import Caster, dot, unit
from toolee_robot.render.embree import Closest
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
        self._found = self._caster.closest(self._directions)
        grid = (intrinsics.height, intrinsics.width)
        depth, ids = _seen(scene.bodies, self._found)
        self.depth, self.body_ids = depth.reshape(grid), ids.reshape(grid)

    def develop(self, antialias: bool = True, exposure: float = 1.0, auto_exposure: float = 0.0) -> Rendering:
        """Shade it; arguments as for `render`."""
        grid, caster, rays, found = self.depth.shape, self._caster, self._directions, self._found
        outlines = np.zeros(0, np.int64)
        if antialias:
            outlines = _outlines(self.depth, found.mesh.reshape(grid))
            more = self._around(outlines)
            rays, found = np.concatenate([rays, more], axis=1), found.followed_by(caster.closest(more))
        hits = caster.hits(rays, found)
        color = self._background(rays, found.mesh, outlines)
        cos, shininess = np.zeros((2, rays.shape[1]), np.float32)
        color[:, hits.ray], shininess[hits.ray] = caster.shade(hits, (grid[0], grid[1]))
        cos[hits.ray] = np.clip(dot(hits.normals, hits.views), 0.0, 1.0)
        color, further = np.split(color, [self.depth.size], axis=1)
        color[:, outlines] += further.reshape(3, len(_SUBPIXELS), -1).sum(axis=1)
        color[:, outlines] /= 1 + len(_SUBPIXELS)
        if auto_exposure > 0:
            mean = float(np.minimum(color, 1.0).mean())
            exposure *= float(np.clip((_MIDDLE_GREY / max(mean, 1e-3)) ** auto_exposure, 0.4, 6.0))
        return Rendering(
            rgb=np.ascontiguousarray(to_srgb(color * np.float32(exposure)).reshape(3, *grid).transpose(1, 2, 0)),
            depth=self.depth,
            body_ids=self.body_ids,
            cos_incidence=cos[: self.depth.size].reshape(grid),
            shininess=shininess[: self.depth.size].reshape(grid),
        )

    def _around(self, pixels: NDArray[np.int64]) -> FloatArray:
        """(3, N) further rays through these pixels, a whole set for each of `_SUBPIXELS`."""
        K = self._intrinsics
        rows, columns = np.divmod(pixels, K.width)
        rays = np.ones((3, len(_SUBPIXELS), len(pixels)), np.float32)
        for k, (du, dv) in enumerate(_SUBPIXELS):
            rays[0, k], rays[1, k] = (columns + (du - K.cx)) / K.fx, (rows + (dv - K.cy)) / K.fy
        return rays.reshape(3, -1)

    def _background(self, rays: FloatArray, body: NDArray[np.int32], outlines: NDArray[np.int64]) -> FloatArray:
        """(3, N) linear colour along those rays that hit nothing (body -1); anything elsewhere."""
        image = self._scene.background
        if image is not None:
            if image.shape != (*self.depth.shape, 3):
                raise ValueError(f"background is {image.shape}, the camera's image is {(*self.depth.shape, 3)}")
            flat = np.ascontiguousarray(image.reshape(-1, 3).T, np.float32)
            return np.concatenate([flat, *[flat[:, outlines]] * len(_SUBPIXELS)], axis=1)
        color = np.empty_like(rays)
        missed = np.flatnonzero(body < 0)
        towards = unit(self._caster.R_world_camera @ rays[:, missed])
        color[:, missed] = self._caster.environment.specular(towards, 0.0)
        return color


def cast(
    bodies: Sequence[Body],
    intrinsics: CameraIntrinsics,
    X_world_camera: Array,
    region: tuple[int, int, int, int] | None = None,
) -> tuple[FloatArray, NDArray[np.int16]]:
    """depth [m] and body_ids as in `Rendering`, without colours, of the pixels x0 <= x < x1, y0 <= y < y1."""
    x0, y0, x1, y1 = region if region is not None else (0, 0, intrinsics.width, intrinsics.height)
    found = Caster(Scene(bodies), X_world_camera).closest(_rays(intrinsics, (x0, y0, x1, y1)))
    depth, ids = _seen(bodies, found)
    return depth.reshape(y1 - y0, x1 - x0), ids.reshape(y1 - y0, x1 - x0)


def _seen(bodies: Sequence[Body], found: Closest) -> tuple[FloatArray, NDArray[np.int16]]:
    """depth and body_ids, (N,) each, as in `Rendering`."""
    ids = np.array([b.body_id for b in bodies] + [-1], np.int16)[found.mesh]  # mesh -1 takes the last entry
    return np.where(found.mesh >= 0, found.distance, np.float32(0)), ids


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


def _outlines(depth: FloatArray, body: NDArray[np.int32]) -> NDArray[np.int64]:
    """The pixels, numbered row by row, beside which another body or a step in depth begins; images (H, W)."""
    edge = np.zeros(body.shape, bool)
    for axis in (0, 1):
        a = [slice(None)] * 2
        b = [slice(None)] * 2
        a[axis], b[axis] = slice(1, None), slice(None, -1)
        da, db = depth[tuple(a)], depth[tuple(b)]
        step = (body[tuple(a)] != body[tuple(b)]) | (np.abs(da - db) > 0.02 * np.minimum(da, db))
        edge[tuple(a)] |= step
        edge[tuple(b)] |= step
    return np.flatnonzero(edge)
