"""A scene in Mitsuba: geometry of the camera's pixels from its rays, radiance by path tracing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.path_tracing.library import mitsuba
from toolee_robot.render.path_tracing.lighting import lamps, panorama
from toolee_robot.render.path_tracing.materials import Finish, finish_of
from toolee_robot.render.path_tracing.meshes import is_endless, mitsuba_mesh
from toolee_robot.render.path_tracing.surroundings import Surroundings
from toolee_robot.render.renderer import Region
from toolee_robot.render.scene import Body, Scene
from toolee_robot.types import CameraIntrinsics

_OPEN = 0.5
"""Share of the scenes with walls that are shown without them, in a panorama."""
_BOUNCES = 4
"""Largest number of edges of a light path."""
_PASSES, _OUTLIER = 3, 2.0
"""Passes of a picture, and the multiple of their median at a pixel to which each is limited."""
_NEAR, _FAR = 0.01, 100.0
"""Range of the camera's rays [m]."""
_AOVS = "position:position,normal:sh_normal,shape:shape_index"


class PathTracedView:
    """A scene seen by a camera, with random materials and lights of its own.

    The panorama is at infinity and has no depth; a lamp has none either.

    Args:
        scene: The scene; its lights, environment and background are not used.
        intrinsics: Intrinsics of the camera; fx and fy must be equal.
        X_world_camera: Pose of the camera in the world, (4, 4).
        surroundings: Panoramas and textures.
        rng: Random generator of materials and lights.

    Attributes:
        depth: Depth along the optical axis, (H, W) float32 [m]; 0 where nothing is hit.
        body_ids: `Body.body_id`, (H, W) int16; -1 where nothing is hit.
        cos_incidence: Cosine of the angle between ray and surface normal, (H, W) float32.
        shininess: Share of specular reflection, (H, W) float32.

    Raises:
        UserError: Mitsuba is not installed.
        ValueError: fx and fy differ.
    """

    def __init__(
        self,
        scene: Scene,
        intrinsics: CameraIntrinsics,
        X_world_camera: Array,
        surroundings: Surroundings,
        rng: np.random.Generator,
    ) -> None:
        if intrinsics.fx != intrinsics.fy:
            raise ValueError(f"fx {intrinsics.fx} and fy {intrinsics.fy}: Mitsuba's camera has square pixels")
        self._intrinsics, self._X_world_camera = intrinsics, np.asarray(X_world_camera, np.float64)
        walled = scene.background is None and rng.random() >= _OPEN
        self._bodies = [body for body in scene.bodies if walled or not is_endless(body)]
        finishes = [finish_of(body.material, is_endless(body), surroundings, rng) for body in self._bodies]
        self._shapes = {
            f"body{k:04d}": _shape(f"body{k:04d}", body, finish)
            for k, (body, finish) in enumerate(zip(self._bodies, finishes, strict=True))
        }
        camera = self._X_world_camera[:3, 3]
        emitters = lamps(camera, self._ceiling(), rng) if walled else panorama(surroundings, rng)
        self._scene = mitsuba().load_dict({"type": "scene", **emitters, **self._shapes})
        image = (0, 0, intrinsics.width, intrinsics.height)
        self.depth, found, self.cos_incidence = self._seen(self._scene, image)
        self.body_ids: NDArray[np.int16] = np.array([b.body_id for b in self._bodies] + [-1], np.int16)[found]
        self.shininess = np.array([f.shininess for f in finishes] + [0.0], np.float32)[found]

    def depth_of(self, body_id: int, region: Region) -> FloatArray:
        """Depth of a region as if only the bodies of one id were there.

        Args:
            body_id: The id.
            region: The region x0, y0, x1, y1 [px].

        Returns:
            The depth, (H', W') [m].
        """
        shapes = zip(self._bodies, self._shapes.items(), strict=True)
        alone = {name: shape for body, (name, shape) in shapes if body.body_id == body_id}
        return self._seen(mitsuba().load_dict({"type": "scene", **alone}), region)[0]

    def radiance(self, samples: int, seed: int) -> FloatArray:
        """Trace the picture.

        It is traced in three passes. What only one of them finds bright, rare paths to a lamp, is limited to twice the
        median.

        Args:
            samples: Paths a pixel in each pass.
            seed: Seed of the paths.

        Returns:
            Linear RGB, (H, W, 3).
        """
        mi = mitsuba()
        image = (0, 0, self._intrinsics.width, self._intrinsics.height)
        sensor = self._sensor(image, {"type": "gaussian"}, {"type": "independent"})
        integrator = mi.load_dict({"type": "path", "max_depth": _BOUNCES})
        scene = self._scene
        passes = [
            np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=samples, seed=seed + k), np.float32)
            for k in range(_PASSES)
        ]
        traced = np.maximum(np.stack(passes)[..., :3], 0.0)
        limit = _OUTLIER * np.median(traced, axis=0) + np.float32(0.02 * traced.mean())
        return np.asarray(np.minimum(traced, limit).mean(axis=0), np.float32)

    def _seen(self, scene: Any, region: Region) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
        """Depth [m], index of the body (-1: none) and cosine of incidence in a region's pixel centres."""
        mi = mitsuba()
        integrator = mi.load_dict({"type": "aov", "aovs": _AOVS})
        sensor = self._sensor(region, {"type": "box"}, {"type": "stratified", "sample_count": 1, "jitter": False})
        values = np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=1), np.float32)
        position, normal, shape = values[..., -7:-4], values[..., -4:-1], values[..., -1]
        names = [str(s.id()) for s in scene.shapes()]
        # Shapes are counted from 1; 0 is none.
        numbers = np.array([-1] + [int(name[4:]) if name in self._shapes else -1 for name in names])
        body = numbers[shape.astype(np.int64)]
        hit = body >= 0
        points = transform_points(inverse(self._X_world_camera), position.reshape(-1, 3).astype(np.float64))
        depth = np.where(hit, points[:, 2].reshape(hit.shape), 0.0).astype(np.float32)
        ray = position - self._X_world_camera[:3, 3]
        cosine = np.abs(np.einsum("ijk,ijk->ij", ray, normal)) / np.maximum(np.linalg.norm(ray, axis=2), 1e-9)
        return depth, body, np.where(hit, np.minimum(cosine, 1.0), 0.0).astype(np.float32)

    def _sensor(self, region: Region, rfilter: dict[str, Any], sampler: dict[str, Any]) -> Any:
        """The camera, of which a region is developed."""
        mi, K = mitsuba(), self._intrinsics
        x0, y0, x1, y1 = region
        crop = {"crop_offset_x": x0, "crop_offset_y": y0, "crop_width": x1 - x0, "crop_height": y1 - y0}
        formats = {"pixel_format": "rgb", "component_format": "float32"}
        film = {"type": "hdrfilm", "width": K.width, "height": K.height, **formats, **crop, "rfilter": rfilter}
        # Mitsuba's camera has x to the left and y up; the centre of its first pixel is at 0.5.
        X = self._X_world_camera @ np.diag([-1.0, -1.0, 1.0, 1.0])
        return mi.load_dict(
            {
                "type": "perspective",
                "fov": float(np.rad2deg(2.0 * np.arctan(K.width / (2.0 * K.fx)))),
                "fov_axis": "x",
                "principal_point_offset_x": 0.5 - (K.cx + 0.5) / K.width,
                "principal_point_offset_y": 0.5 - (K.cy + 0.5) / K.height,
                "near_clip": _NEAR,
                "far_clip": _FAR,
                "to_world": mi.ScalarTransform4f(X),
                "film": film,
                "sampler": sampler,
            }
        )

    def _ceiling(self) -> float | None:
        """Height of a square that faces down [m], world frame; None where there is none."""
        down = [b.X_world_body[2, 3] for b in self._bodies if is_endless(b) and b.X_world_body[2, 2] < -0.9]
        return float(max(down)) if down else None


def _shape(name: str, body: Body, finish: Finish) -> Any:
    bsdf = mitsuba().load_dict(finish.bsdf)
    return mitsuba_mesh(name, body, bsdf, finish.texture_size, body.material.axis)
