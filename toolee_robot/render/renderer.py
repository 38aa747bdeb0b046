"""The renderer: ray casting and shading without OpenGL or system libraries.

Equal calls on one device give identical bytes.

rendering = render(Scene([Body(box((0.1, 0.1, 0.1)), X_world_box)]), intrinsics, X_world_camera)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import warp as wp
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.render.caster import Caster, Hits, picture
from toolee_robot.render.device import DeviceArray, checked, empty, launch, put
from toolee_robot.render.kernels import image as kernels
from toolee_robot.render.material import Rendering, Scene
from toolee_robot.render.mesh import FloatArray
from toolee_robot.types import CameraIntrinsics

_MIDDLE_GREY = 0.2
"""Target of the automatic exposure: mean linear brightness."""
_SUBPIXELS = np.array([(-0.33, -0.17), (0.33, 0.17)], np.float32)
"""Offsets of the additional rays of outline pixels from the pixel centre [px]."""

Region = tuple[int, int, int, int]
"""The pixels x0 <= x < x1, y0 <= y < y1."""


def render(
    scene: Scene,
    intrinsics: CameraIntrinsics,
    X_world_camera: Array,
    antialias: bool = True,
    auto_exposure: float = 0.0,
    device: str = "cpu",
) -> Rendering:
    """Render the scene from a camera (OpenCV axes: x right, y down, z forward).

    Args:
        scene: The scene.
        intrinsics: Intrinsics of the camera.
        X_world_camera: Pose of the camera in the world frame, 4x4 [m].
        antialias: Cast two additional rays through each outline pixel, for the colour only; depth and ids are those of
            the pixel centre.
        auto_exposure: Strength of the compensation of dark and bright scenes, in [0, 1].
        device: "cpu", or "cuda" for an NVIDIA GPU.

    Returns:
        The images, in memory.

    Raises:
        UserError: The device is not available.
    """
    shot = Shot(scene, intrinsics, X_world_camera, device)
    image = shot.develop(antialias, auto_exposure=auto_exposure)
    grid = shot.depth.shape
    return Rendering(
        rgb=image.rgb.numpy().reshape(*grid, 3),
        depth=shot.depth,
        body_ids=shot.body_ids,
        cos_incidence=image.cos_incidence.numpy().reshape(grid),
        shininess=image.shininess.numpy().reshape(grid),
    )


@dataclass(frozen=True, eq=False)
class Image:
    """The images of a `Rendering`, still on its device.

    Attributes:
        rgb: Colour, sRGB, (H, W, 3) uint8.
        depth: Depth, (H, W) float32 [m].
        cos_incidence: As in `Rendering`, (H, W) float32.
        shininess: As in `Rendering`, (H, W) float32.
    """

    rgb: DeviceArray
    depth: DeviceArray
    cos_incidence: DeviceArray
    shininess: DeviceArray


class Shot:
    """A scene seen by a camera before it is shaded, so that a scene can be rejected without the cost of its colours.

    Args:
        scene: The scene.
        intrinsics: Intrinsics of the camera.
        X_world_camera: Pose of the camera in the world, (4, 4).
        device: "cpu" or "cuda".

    Attributes:
        depth: As in `Rendering`, (H, W) float32 [m].
        body_ids: As in `Rendering`, (H, W) int16.
    """

    def __init__(self, scene: Scene, intrinsics: CameraIntrinsics, X_world_camera: Array, device: str = "cpu") -> None:
        self._scene, self._intrinsics, self.device = scene, intrinsics, checked(device)
        self._caster = Caster(scene, X_world_camera, device)
        self._rays = _rays(intrinsics, (0, 0, intrinsics.width, intrinsics.height), device)
        self._found = self._caster.closest(self._rays)
        self._grid = (intrinsics.height, intrinsics.width)
        self.depth: FloatArray = self._found.values[0].numpy().reshape(self._grid)
        names = np.array([b.body_id for b in scene.bodies] + [-1], np.int16)
        bodies = self._found.ids[1].numpy().reshape(self._grid)
        self.body_ids: NDArray[np.int16] = names[bodies]  # -1 takes the last entry

    def depth_of(self, body_id: int, region: Region) -> FloatArray:
        """Depth of a region as if only the bodies of one id were there.

        Args:
            body_id: The id.
            region: The region x0, y0, x1, y1 [px].

        Returns:
            The depth, (H', W') [m].
        """
        x0, y0, x1, y1 = region
        of_id = [k for k, body in enumerate(self._scene.bodies) if body.body_id == body_id]
        found = self._caster.closest(_rays(self._intrinsics, region, self.device), of_id)
        depth: FloatArray = found.values[0].numpy()
        return depth.reshape(y1 - y0, x1 - x0)

    def develop(self, antialias: bool = True, exposure: float = 1.0, auto_exposure: float = 0.0) -> Image:
        """Shade the scene.

        Args:
            antialias: As in `render`.
            exposure: Factor on the linear colour before the sRGB curve.
            auto_exposure: As in `render`.

        Returns:
            The images, on the device.
        """
        device, count, behind = self.device, self._rays.shape[1], self._scene.background
        outlines = self._outlines() if antialias else None  # first: from here on nothing waits for a GPU
        background = None if behind is None else picture(behind, *self._grid, device)
        hits = self._caster.shade(self._rays, self._found, self._grid, background)
        if outlines is not None:
            self._smooth(hits, outlines, background)
        light = wp.full(1, exposure, dtype=wp.float32, device=device)
        if auto_exposure > 0:
            total = wp.zeros(1, dtype=wp.int64, device=device)
            launch(kernels.meter, count, hits.colors, total, device=device)
            launch(kernels.adapt, 1, total, 3.0 * count, _MIDDLE_GREY, auto_exposure, light, device=device)
        rgb = empty((count, 3), wp.uint8, device)
        launch(kernels.to_srgb, count, hits.colors, light, _srgb_curve(device), rgb, device=device)
        return Image(
            rgb.reshape((*self._grid, 3)),
            self._found.values[0].reshape(self._grid),
            hits.cos_incidence.reshape(self._grid),
            hits.shininess.reshape(self._grid),
        )

    def _outlines(self) -> DeviceArray | None:
        """The pixels (P,) int32 on outlines, None where there are none."""
        K, found = self._intrinsics, self._found
        marks = empty(self._rays.shape[1], wp.uint8, self.device)
        launch(kernels.outlines, marks.size, found.values, found.ids, K.width, K.height, marks, device=self.device)
        pixels = np.flatnonzero(marks.numpy()).astype(np.int32)
        return put(pixels, wp.int32, self.device) if len(pixels) else None

    def _smooth(self, hits: Hits, pixels: DeviceArray, background: DeviceArray | None) -> None:
        """Mix what further rays through these pixels find into their colours."""
        K, device = self._intrinsics, self.device
        rays = empty((3, len(_SUBPIXELS) * pixels.size), wp.float32, device)
        camera = (K.width, K.fx, K.fy, K.cx, K.cy)
        launch(kernels.rays_beside, rays.shape[1], pixels, *camera, _subpixels(device), rays, device=device)
        found = self._caster.closest(rays)
        more = self._caster.shade(rays, found, None, background, pixels, self._rays.shape[1])
        launch(kernels.mix_in, pixels.size, pixels, more.colors, len(_SUBPIXELS), hits.colors, device=device)


def pixel_rays(intrinsics: CameraIntrinsics) -> FloatArray:
    """(H, W, 3) rays through the pixel centres, z = 1, camera frame."""
    grid = (intrinsics.height, intrinsics.width)
    rays = _rays(intrinsics, (0, 0, *grid[::-1]), checked("cpu")).numpy()
    return np.ascontiguousarray(rays.T).reshape(*grid, 3)


def _rays(intrinsics: CameraIntrinsics, region: Region, device: str) -> DeviceArray:
    """(3, N) rays through the centres of a region's pixels, z = 1, camera frame."""
    x0, y0, x1, y1 = region
    K = intrinsics
    rays = empty((3, (x1 - x0) * (y1 - y0)), wp.float32, device)
    camera = (x1 - x0, x0, y0, K.fx, K.fy, K.cx, K.cy)
    launch(kernels.pixel_rays, rays.shape[1], *camera, rays, device=device)
    return rays


@lru_cache
def _subpixels(device: str) -> DeviceArray:
    return put(_SUBPIXELS, wp.vec2, device)


@lru_cache
def _srgb_curve(device: str) -> DeviceArray:
    x = np.arange(kernels.CURVE) / (kernels.CURVE - 1)
    y = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return put(np.round(255 * y).astype(np.uint8), wp.uint8, device)
