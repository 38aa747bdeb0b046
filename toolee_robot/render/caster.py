"""Ray casting and shading of a scene in the camera frame, its environment maps and background images.

The camera frame keeps float32 precise. Rays are (u, v, 1) from the origin, so that the ray parameter of a hit is its
depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import warp as wp
from scipy.ndimage import gaussian_filter

from toolee_robot.frames import Array, inverse
from toolee_robot.render.device import DeviceArray, empty, launch, put, rows_of
from toolee_robot.render.kernels import light as kernels
from toolee_robot.render.kernels import surroundings
from toolee_robot.render.kernels.surroundings import TABLE_SIZE, Surface
from toolee_robot.render.material import Backdrop, Environment, Light, Scene
from toolee_robot.render.mesh import Mesh
from toolee_robot.render.rays import BvhTracer, EmbreeTracer, Found, Tracer

_BLURS = (0.05, 0.25, 0.6, 1.0)
"""Blur half-widths [rad] of the maps; the last map is the diffuse irradiance."""
assert len(_BLURS) == surroundings.SKY_LEVELS


def sky_maps(environment: Environment, device: str) -> DeviceArray:
    """Blurred environment maps, in the layout of `kernels.surroundings.sky`.

    Args:
        environment: Light from all directions.
        device: Warp device.

    Returns:
        The maps, row-major, (4 * 64 * 64,) vec3, linear RGB.
    """
    lobes = rows_of(surroundings.Lobe, [(lobe.direction, lobe.width, lobe.color) for lobe in environment.lobes])
    maps = empty(surroundings.SKY_LEVELS * surroundings.SKY_SIZE**2, wp.vec3, device)
    colors = (wp.vec3(c) for c in (environment.zenith, environment.horizon, environment.ground))
    launch(
        surroundings.bake,
        maps.size,
        *colors,
        put(lobes, surroundings.Lobe, device),
        _blurs(device),
        maps,
        device=device,
    )
    return maps


def picture(backdrop: Backdrop, height: int, width: int, device: str) -> DeviceArray:
    """Background image of a backdrop.

    Args:
        backdrop: The backdrop.
        height: Height of the image [px].
        width: Width of the image [px].
        device: Warp device.

    Returns:
        The image, row-major, (H * W,) vec3, linear RGB.
    """
    rows = [(p.centre, p.half_axes, np.cos(p.angle), np.sin(p.angle), p.oval, p.color) for p in backdrop.patches]
    patches = rows_of(surroundings.Patch, rows)
    out = empty(height * width, wp.vec3, device)
    colors = (wp.vec3(c) for c in (backdrop.corner, backdrop.right, backdrop.down))
    launch(
        surroundings.backdrop, out.size, width, *colors, put(patches, surroundings.Patch, device), out, device=device
    )
    return out


@lru_cache
def _blurs(device: str) -> DeviceArray:
    return put(np.array(_BLURS, np.float32), wp.float32, device)


_SHADOW_BLUR = 2
"""Radius [px] of the smoothing of soft kernels."""


@dataclass(frozen=True, eq=False)
class Hits:
    """Shading of N rays.

    Attributes:
        colors: Linear RGB (N,) vec3.
        cos_incidence: Cosine of the angle of incidence (N,).
        shininess: Share of specular reflection (N,), in [0, 1].
    """

    colors: DeviceArray
    cos_incidence: DeviceArray
    shininess: DeviceArray


class Caster:
    """A scene in the camera frame, prepared for ray casting.

    Args:
        scene: The scene.
        X_world_camera: Pose of the camera in the world frame, 4x4 [m].
        device: "cpu" or "cuda".
    """

    def __init__(self, scene: Scene, X_world_camera: Array, device: str) -> None:
        self.scene, self.device = scene, device
        self._X_camera_world = inverse(np.asarray(X_world_camera, dtype=np.float64))
        self._meshes = [(body.mesh, self._X_camera_world @ body.X_world_body) for body in scene.bodies]
        self._tracer = tracer_of(self._meshes, device)

    def closest(self, rays: DeviceArray, only: Sequence[int] | None = None) -> Found:
        """Find the closest hits of rays.

        Args:
            rays: Ray directions (3, N) with z = 1, camera frame.
            only: Indices of the bodies to consider; None: all.

        Returns:
            The hits; mesh numbers are indices into the bodies of the scene, or into `only`.
        """
        if only is None:
            return self._tracer.closest(rays)
        return tracer_of([self._meshes[k] for k in only], self.device).closest(rays)

    def shade(
        self,
        rays: DeviceArray,
        found: Found,
        grid: tuple[int, int] | None = None,
        background: DeviceArray | None = None,
        pixels: DeviceArray | None = None,
        first: int = 0,
    ) -> Hits:
        """Shade the hits of rays.

        Args:
            rays: Ray directions (3, N) with z = 1, camera frame.
            found: Their hits.
            grid: (H, W) of the image if the rays are its pixels; soft shadows are then smoothed over adjacent pixels.
            background: Background image (H * W,) vec3; None: the environment.
            pixels: Without a grid, pixel indices (P,) int32 of the rays, repeated cyclically.
            first: Number of the first ray; it selects the sample point of each ray on a soft lamp.

        Returns:
            Colours and properties of the hits.
        """
        n, device, look = rays.shape[1], self.device, self._look
        points, normals, colors = (empty(n, wp.vec3, device) for _ in range(3))
        cos_incidence, shininess = (empty(n, wp.float32, device) for _ in range(2))
        geometry = (look.first_face, look.corner_normals, look.surfaces, noise_table(device))
        out = (points, normals, colors, cos_incidence, shininess)
        launch(kernels.surfaces_hit, n, rays, found.values, found.ids, *geometry, *out, device=device)
        seen = self._seen(found, points, normals, grid, first)
        lights = (look.lamps, seen, look.sky, wp.mat33(self._X_camera_world[:3, :3].T))
        behind = (look.nothing if background is None else background, look.nobody if pixels is None else pixels)
        place = (rays, found.ids, points, normals, look.surfaces)
        launch(kernels.shade, n, *place, *lights, *behind, colors, device=device)
        return Hits(colors, cos_incidence, shininess)

    def _seen(
        self, found: Found, points: DeviceArray, normals: DeviceArray, grid: tuple[int, int] | None, first: int
    ) -> DeviceArray:
        """Visible share (L, N) of each lamp at each hit; for a lamp with shadows, 0 where the surface faces away."""
        n, device, look = found.ids.shape[1], self.device, self._look
        seen = empty((len(self.scene.lights), n), wp.float32, device)
        origins, directions = empty((3, n), wp.float32, device), empty((3, n), wp.float32, device)
        reach, counts = empty(n, wp.float32, device), empty(n, wp.int32, device)
        for k, light in enumerate(self.scene.lights):
            if not light.shadow:
                seen[k].fill_(1.0)
                continue
            asked = (origins, directions, reach)
            launch(kernels.rays_to_lamp, n, found.ids, points, normals, look.lamps, k, first, *asked, device=device)
            blocked = self._tracer.blocked(*asked)
            if light.softness == 0 or grid is None:
                launch(kernels.seen_unblurred, n, reach, blocked, k, seen, device=device)
                continue
            height, width = grid
            launch(kernels.count_beside, n, reach, blocked, width, _SHADOW_BLUR, counts, device=device)
            launch(kernels.seen_blurred, n, reach, counts, width, height, _SHADOW_BLUR, k, seen, device=device)
        return seen

    @cached_property
    def _look(self) -> _Look:
        """Shading data, computed on first use: depth images do not need it."""
        scene, device = self.scene, self.device
        posed = zip(scene.bodies, self._meshes, strict=True)
        surfaces = [(X[:3, :3], X[:3, 3], *body.material.row) for body, (_, X) in posed]
        lamps = [(self._place(l), l.color, l.position is None, l.softness) for l in scene.lights]
        faces = np.cumsum([0, *(len(body.mesh.faces) for body in scene.bodies)]).astype(np.int32)
        normals = [body.mesh.corner_normals.reshape(-1, 3) for body in scene.bodies]
        return _Look(
            surfaces=put(rows_of(Surface, surfaces), Surface, device),
            lamps=put(rows_of(kernels.Lamp, lamps), kernels.Lamp, device),
            first_face=put(faces, wp.int32, device),
            corner_normals=put(np.concatenate([np.zeros((0, 3), np.float32), *normals]), wp.vec3, device),
            sky=sky_maps(scene.environment, device),
            nobody=empty(0, wp.int32, device),
            nothing=empty(0, wp.vec3, device),
        )

    def _place(self, light: Light) -> Array:
        """Unit direction of a distant lamp or position [m] of a near lamp (3,), camera frame."""
        X = self._X_camera_world
        if light.position is not None:
            return np.asarray(X[:3, :3] @ np.asarray(light.position) + X[:3, 3])
        far = X[:3, :3] @ np.asarray(light.direction)
        return np.asarray(far / np.linalg.norm(far))


@dataclass(frozen=True, eq=False)
class _Look:
    """Shading data of a scene on the device.

    Attributes:
        surfaces: `Surface` of each body.
        lamps: `Lamp` of each light.
        first_face: Index of the first face of each body, and the total.
        corner_normals: Corner normals of all faces, flattened, body frames.
        sky: Environment maps (`sky_maps`).
        nobody: Empty array of indices.
        nothing: Empty array of colours.
    """

    surfaces: DeviceArray
    lamps: DeviceArray
    first_face: DeviceArray
    corner_normals: DeviceArray
    sky: DeviceArray
    nobody: DeviceArray
    nothing: DeviceArray


_BLUR = 16.0 / 3
"""Standard deviation of the blur [cells]; features have a size of about 16 cells."""


@lru_cache
def noise_table(device: str) -> DeviceArray:
    """(128^3,) float32: tileable noise, uniform in [0, 1] by rank, the same in every process."""
    rng = np.random.Generator(np.random.PCG64(20240717))
    smooth = gaussian_filter(rng.standard_normal((TABLE_SIZE,) * 3).astype(np.float32), _BLUR, mode="wrap")
    smooth /= smooth.std()
    # Normal to uniform by the logistic approximation of the normal distribution function.
    table = (1.0 / (1.0 + np.exp(-1.702 * smooth))).reshape(-1).astype(np.float32)
    return put(table, wp.float32, device)


def tracer_of(meshes: Sequence[tuple[Mesh, Array]], device: str) -> Tracer:
    """Build the ray tracer of a device: Embree on the CPU, Warp's trees on a GPU.

    Args:
        meshes: The meshes, each with its X_camera_body, (4, 4).
        device: Warp device.

    Returns:
        The tracer.
    """
    return EmbreeTracer(meshes) if device == "cpu" else BvhTracer(meshes, device)
