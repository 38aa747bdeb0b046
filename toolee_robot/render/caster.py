"""A scene placed in one camera's frame: where rays hit it and what light comes back along them.

Everything is computed in the camera frame, where float32 is precise: rays are (u, v, 1) from the origin, so that the
ray parameter of a hit is its depth. Vectors lie component by component, (3, M): numpy is several times as fast on long
rows as on rows of three.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array, inverse
from toolee_robot.render.embree import Closest, Tracer
from toolee_robot.render.environment import EnvironmentMap
from toolee_robot.render.filters import neighbours
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.scene import Light, Scene

_SHADOW_OFFSET = 4e-4
"""Shadow rays start this far [m] off the surface, or surfaces would shadow themselves."""
_SHADOW_BLUR = 2
"""Soft shadows are smoothed over this many pixels to each side."""
_CHUNK = 16384
"""Hits shaded together: what is computed on the way stays in the processor's cache."""


@dataclass(frozen=True, eq=False)
class Hits:
    """Of M rays that hit, sorted by body: ray index (M,), points, unit normals (towards the eye), unit view directions
    (towards the eye), (3, M) each, camera frame. bounds (B + 1,): body b's hits are bounds[b] to bounds[b + 1]."""

    ray: NDArray[np.int64]
    points: FloatArray
    normals: FloatArray
    views: FloatArray
    bounds: NDArray[np.int64]


class Caster:
    """A scene placed in one camera's frame, ready to be shot at."""

    def __init__(self, scene: Scene, X_world_camera: Array) -> None:
        X_camera_world = inverse(np.asarray(X_world_camera, dtype=np.float64))
        self.scene = scene
        self.R_world_camera = np.asarray(X_world_camera[:3, :3], np.float32)
        self.X_camera_world = X_camera_world
        self.poses: list[tuple[FloatArray, FloatArray]] = []
        meshes = []
        for body in scene.bodies:
            X = X_camera_world @ body.X_world_body
            self.poses.append((X[:3, :3].astype(np.float32), X[:3, 3:].astype(np.float32)))
            # In float64, then rounded once: a millimetre-exact depth must survive far-away world origins.
            vertices = body.mesh.vertices.astype(np.float64) @ X[:3, :3].T + X[:3, 3]
            meshes.append((vertices.astype(np.float32), body.mesh.faces))
        self.tracer = Tracer(meshes)

    @cached_property
    def environment(self) -> EnvironmentMap:
        """The light from all around; not made where only depths are asked for."""
        return EnvironmentMap(self.scene.environment)

    def closest(self, directions: FloatArray) -> Closest:
        """What rays (3, N) with z = 1 hit; meshes are numbered as the scene's bodies."""
        return self.tracer.closest(directions)

    def hits(self, directions: FloatArray, found: Closest) -> Hits:
        """Those of the rays (3, N) that hit."""
        count = len(self.scene.bodies)
        # Few enough values for a radix sort; what missed comes last.
        key = np.where(found.mesh >= 0, found.mesh, count).astype(np.int16)
        bounds = np.concatenate([[0], np.cumsum(np.bincount(key, minlength=count + 1))[:count]])
        ray = np.argsort(key, kind="stable")[: bounds[-1]]
        d = directions.take(ray, axis=1)
        normals = np.empty_like(d)
        face, u, v = found.face.take(ray), found.u.take(ray), found.v.take(ray)
        for i in map(int, np.flatnonzero(np.diff(bounds))):
            part = slice(bounds[i], bounds[i + 1])
            rows = self.scene.bodies[i].mesh.corner_normals.reshape(-1, 9).take(face[part], axis=0)
            corner, b, c = np.ascontiguousarray(rows.T), u[part], v[part]
            normals[:, part] = self.poses[i][0] @ (corner[:3] * (1 - b - c) + corner[3:6] * b + corner[6:] * c)
        normals = unit(normals)
        # Open or badly wound meshes show their backs: shade both sides alike.
        geometric = found.normals.take(ray, axis=1)
        behind = dot(normals, geometric) * dot(geometric, d) > 0
        normals *= 1 - 2 * behind.astype(np.float32)
        return Hits(ray, d * found.distance.take(ray), normals, -unit(d), bounds)

    def shade(self, hits: Hits, grid: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        """Linear colour (3, M) and shininess (M,) of the hits. grid: (H, W) of the image whose pixels the first H * W
        rays are; soft shadows are smoothed over neighbours in it. Further rays stand for themselves."""
        counts = np.diff(hits.bounds)
        roughness = np.repeat(np.array([b.material.roughness for b in self.scene.bodies], np.float32), counts)
        metallic = np.repeat(np.array([b.material.metallic for b in self.scene.bodies], np.float32), counts)
        color = self._albedo(hits)
        seen = [self._visibility(light, hits, grid) if light.shadow else None for light in self.scene.lights]
        for start in range(0, len(hits.ray), _CHUNK):
            part = slice(start, start + _CHUNK)
            lamps = [(light, None if s is None else s[part]) for light, s in zip(self.scene.lights, seen, strict=True)]
            place = (hits.points[:, part], hits.normals[:, part], hits.views[:, part])
            color[:, part] = self._lit(color[:, part], roughness[part], metallic[part], place, lamps)
        return color, (1 - roughness) * (np.float32(0.1) + np.float32(0.9) * metallic)

    def _albedo(self, hits: Hits) -> FloatArray:
        """(3, M) at the hits."""
        albedo = np.empty_like(hits.points)
        for i in map(int, np.flatnonzero(np.diff(hits.bounds))):
            R, p = self.poses[i]
            for start in range(hits.bounds[i], hits.bounds[i + 1], _CHUNK):
                part = slice(start, min(start + _CHUNK, hits.bounds[i + 1]))
                albedo[:, part] = self.scene.bodies[i].material.albedo(R.T @ (hits.points[:, part] - p))
        return albedo

    def _lit(
        self,
        albedo: FloatArray,
        roughness: FloatArray,
        metallic: FloatArray,
        place: tuple[FloatArray, FloatArray, FloatArray],
        lamps: list[tuple[Light, FloatArray | None]],
    ) -> FloatArray:
        """(3, M) light reflected at points with normals and views (`place`): environment and lamps, Lambert plus GGX.
        lamps: with the share of each that is seen."""
        points, n, v = place
        cos = dot(n, v)
        n_v = np.clip(cos, 1e-3, 1.0)
        f0 = np.float32(0.04) * (1 - metallic) + albedo * metallic
        diffuse = albedo * (1 - metallic)
        mirror = 2 * n_v * n - v
        away = 1 - n_v
        glancing = (away * away) ** 2 * away * (1 - roughness)
        color = diffuse * self.environment.diffuse(self.R_world_camera @ n)
        color += (f0 + (1 - f0) * glancing) * self.environment.specular(self.R_world_camera @ mirror, roughness)
        a2 = np.maximum(roughness, np.float32(0.12)) ** 2
        a2 *= a2
        k = (roughness + 1) ** 2 / 8
        masked = 4 * (n_v * (1 - k) + k)
        for light, seen in lamps:
            to_lamp, _, power = self._towards(light, points)
            l_n, l_v = dot(to_lamp, n), dot(to_lamp, v)
            n_l = np.clip(l_n, 0.0, 1.0)
            # The half vector's cosine without the vector.
            n_h = np.clip((l_n + cos) / np.sqrt(np.maximum(2 + 2 * l_v, np.float32(1e-12))), 0.0, 1.0)
            spread = n_h * n_h * (a2 - 1) + 1
            gloss = a2 / (np.float32(np.pi) * spread * spread * (n_l * (1 - k) + k) * masked)
            weight = n_l * power if seen is None else n_l * power * seen
            reflected = diffuse + f0 * np.minimum(np.float32(np.pi) * gloss, np.float32(40.0 * np.pi))
            color += reflected * weight * np.asarray(light.color, np.float32)[:, None]
        return color

    def _towards(self, light: Light, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Unit vectors to the lamp (3, M) ((3, 1) to a far one), distance [m] and strength, (M,) or (1,) each."""
        X = self.X_camera_world
        if light.position is None:
            far = (X[:3, :3] @ np.asarray(light.direction)).astype(np.float32)[:, None]
            return unit(far), np.full(1, 1e3, np.float32), np.ones(1, np.float32)
        to_lamp = (X[:3, :3] @ np.asarray(light.position) + X[:3, 3]).astype(np.float32)[:, None] - points
        distance = np.sqrt(dot(to_lamp, to_lamp))
        nearest = np.maximum(distance, np.float32(0.05))
        return to_lamp / distance, distance, np.reciprocal(nearest * nearest)

    def _visibility(self, light: Light, hits: Hits, grid: tuple[int, int]) -> FloatArray:
        """(M,) share of the lamp seen from each hit; 0 where the surface faces away from it."""
        to_lamp, distance, _ = self._towards(light, hits.points)
        index = np.flatnonzero(dot(to_lamp, hits.normals) > 0)
        seen = np.zeros(len(hits.ray), np.float32)
        ray = hits.ray.take(index)
        if light.position is not None:
            to_lamp, distance = to_lamp.take(index, axis=1), distance.take(index)
        if light.softness > 0:
            # One ray a pixel to a point of the lamp that a fixed hash of the ray index chooses.
            spread = np.float32(light.softness) / (distance if light.position is not None else np.float32(1))
            to_lamp = to_lamp + _jitter_table().take(ray, axis=1, mode="wrap") * spread
        origins = hits.points.take(index, axis=1) + hits.normals.take(index, axis=1) * np.float32(_SHADOW_OFFSET)
        reach = np.broadcast_to(distance - np.float32(2 * _SHADOW_OFFSET), index.shape)
        free = ~self.tracer.blocked(origins, np.broadcast_to(to_lamp, origins.shape), reach)
        if light.softness == 0:
            seen[index] = free
            return seen
        pixels = grid[0] * grid[1]
        image, weight = np.zeros((2, max(pixels, int(ray.max(initial=0)) + 1)), np.uint8)
        image[ray], weight[ray] = free, 1
        for counts in (image, weight):
            counts[:pixels] = neighbours(counts[:pixels].reshape(grid), _SHADOW_BLUR).reshape(-1)
        seen[index] = image.take(ray) / weight.take(ray).astype(np.float32)
        return seen


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """(M,) of vectors (3, M)."""
    product: FloatArray = a[0] * b[0]
    product += a[1] * b[1]
    product += a[2] * b[2]
    return product


def unit(a: FloatArray) -> FloatArray:
    """(3, M) of length 1."""
    length: FloatArray = np.maximum(np.sqrt(dot(a, a)), np.float32(1e-12))
    return a / length


@lru_cache(maxsize=1)
def _jitter_table() -> FloatArray:
    """(3, N) in the cube [-1, 1]^3: the R3 low-discrepancy sequence; its length is a prime above any image's width, so
    that rows differ."""
    alpha = np.array([0.8191725134, 0.6710436067, 0.5497004779])
    return (2.0 * ((np.arange(65537) * alpha[:, None]) % 1.0) - 1.0).astype(np.float32)
