"""A scene placed in one camera's frame: where rays hit it and what light comes back along them.

Everything is computed in the camera frame, where float32 is precise: rays are (u, v, 1) from the origin, so that the
ray parameter of a hit is its depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from toolee_robot.frames import Array, inverse
from toolee_robot.render.environment import EnvironmentMap
from toolee_robot.render.filters import box_blur
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.scene import Light, Scene

_SHADOW_OFFSET = 4e-4
"""Shadow rays start this far [m] off the surface, or surfaces would shadow themselves."""


@dataclass(frozen=True, eq=False)
class Hits:
    """Of M rays that hit, sorted by body: ray index (M,), body index (M,), points, unit normals (towards the eye),
    unit view directions (towards the eye), all camera frame."""

    ray: NDArray[np.int64]
    body: NDArray[np.int32]
    points: FloatArray
    normals: FloatArray
    views: FloatArray


class Caster:
    """A scene placed in one camera's frame, ready to be shot at."""

    def __init__(self, scene: Scene, X_world_camera: Array) -> None:
        X_camera_world = inverse(np.asarray(X_world_camera, dtype=np.float64))
        self.scene = scene
        self.R_world_camera = np.asarray(X_world_camera[:3, :3], np.float32)
        self.X_camera_world = X_camera_world
        self.embree = EmbreeScene()
        self.poses: list[tuple[FloatArray, FloatArray]] = []
        normals: list[FloatArray] = []
        starts = [0]
        for body in scene.bodies:
            X = X_camera_world @ body.X_world_body
            R, p = X[:3, :3].astype(np.float32), X[:3, 3].astype(np.float32)
            self.poses.append((R, p))
            # In float64, then rounded once: a millimetre-exact depth must survive far-away world origins.
            vertices = body.mesh.vertices.astype(np.float64) @ X[:3, :3].T + X[:3, 3]
            TriangleMesh(self.embree, vertices.astype(np.float32), body.mesh.faces)
            normals.append((body.mesh.corner_normals.reshape(-1, 3) @ R.T).reshape(-1, 9))
            starts.append(starts[-1] + len(body.mesh.faces))
        self.corner_normals = np.concatenate(normals) if normals else np.zeros((0, 9), np.float32)
        self.face_starts = np.asarray(starts, np.int64)

    @cached_property
    def environment(self) -> EnvironmentMap:
        """The light from all around; not made where only depths are asked for."""
        return EnvironmentMap(self.scene.environment)

    def cast(self, directions: FloatArray) -> tuple[FloatArray, NDArray[np.int32], Hits]:
        """depth (N,) [m] (0: nothing), body index (N,) (-1: nothing) and the hits of rays (N, 3) with z = 1."""
        n = len(directions)
        if not self.scene.bodies:
            empty = np.zeros((0, 3), np.float32)
            hits = Hits(np.zeros(0, np.int64), np.zeros(0, np.int32), empty, empty, empty)
            return np.zeros(n, np.float32), np.full(n, -1, np.int32), hits
        result = self.embree.run(np.zeros_like(directions), directions, output=1)
        body: NDArray[np.int32] = result["geomID"]
        hit = body >= 0
        depth: FloatArray = np.where(hit, result["tfar"], np.float32(0))
        ray = np.flatnonzero(hit)
        ray = ray[np.argsort(body[ray].astype(np.int16), kind="stable")]
        index = body[ray]
        corner = self.corner_normals[self.face_starts[index] + result["primID"][ray]]
        u, v = result["u"][ray][:, None], result["v"][ray][:, None]
        normals = unit(corner[:, 0:3] * (1 - u - v) + corner[:, 3:6] * u + corner[:, 6:9] * v)
        d = directions[ray]
        views = -unit(d)
        # Open or badly wound meshes show their backs: shade both sides alike.
        facing = np.einsum("ij,ij->i", result["Ng"][ray], d)
        geometric = result["Ng"][ray] * np.where(facing > 0, np.float32(-1), np.float32(1))[:, None]
        flip = np.einsum("ij,ij->i", normals, geometric) < 0
        normals[flip] *= -1
        return depth, body, Hits(ray, index, d * depth[ray][:, None], normals, views)

    def surface(self, hits: Hits) -> tuple[FloatArray, FloatArray, FloatArray]:
        """albedo (M, 3), roughness (M,), metallic (M,) at the hits."""
        albedo = np.empty((len(hits.ray), 3), np.float32)
        bounds = np.searchsorted(hits.body, np.arange(len(self.scene.bodies) + 1))
        for i, body in enumerate(self.scene.bodies):
            part = slice(bounds[i], bounds[i + 1])
            if part.start < part.stop:
                R, p = self.poses[i]
                albedo[part] = body.material.albedo(((hits.points[part] - p) @ R).astype(np.float32, copy=False))
        roughness = np.array([b.material.roughness for b in self.scene.bodies], np.float32)[hits.body]
        metallic = np.array([b.material.metallic for b in self.scene.bodies], np.float32)[hits.body]
        return albedo, roughness, metallic

    def shade(self, hits: Hits, shadow_grid: tuple[int, int] | None) -> tuple[FloatArray, FloatArray]:
        """Linear colour (M, 3) and shininess (M,) of the hits. shadow_grid: (H, W) where the rays are an image's
        pixels, whose soft shadows are then smoothed over neighbours."""
        albedo, roughness, metallic = self.surface(hits)
        n, v = hits.normals, hits.views
        n_v = np.clip(np.einsum("ij,ij->i", n, v), 1e-3, 1.0)
        f0 = np.float32(0.04) * (1 - metallic)[:, None] + albedo * metallic[:, None]
        diffuse_albedo = albedo * (1 - metallic)[:, None]
        mirror = 2 * n_v[:, None] * n - v
        glancing = (1 - n_v) ** 5 * (1 - roughness)
        fresnel = f0 + (1 - f0) * glancing[:, None]
        R = self.R_world_camera
        color = diffuse_albedo * self.environment.diffuse(n @ R.T)
        color += fresnel * self.environment.specular(mirror @ R.T, roughness)
        for light in self.scene.lights:
            color += self._lamp(light, hits, diffuse_albedo, f0, roughness, n_v, shadow_grid)
        shininess = (1 - roughness) * (np.float32(0.1) + np.float32(0.9) * metallic)
        return color, shininess

    def _lamp(
        self,
        light: Light,
        hits: Hits,
        diffuse: FloatArray,
        f0: FloatArray,
        roughness: FloatArray,
        n_v: FloatArray,
        shadow_grid: tuple[int, int] | None,
    ) -> FloatArray:
        """(M, 3) light of one lamp reflected at the hits: Lambert plus GGX, with its shadow."""
        X = self.X_camera_world
        if light.position is not None:
            lamp = (X[:3, :3] @ np.asarray(light.position) + X[:3, 3]).astype(np.float32)
            to_lamp = lamp - hits.points
            distance = np.linalg.norm(to_lamp, axis=1)
            to_lamp /= distance[:, None]
            power = 1.0 / np.maximum(distance, np.float32(0.05)) ** 2
        else:
            far = (X[:3, :3] @ np.asarray(light.direction)).astype(np.float32)
            to_lamp = np.broadcast_to(far / np.linalg.norm(far), hits.points.shape)
            distance = np.full(len(hits.ray), 1e3, np.float32)
            power = np.ones(len(hits.ray), np.float32)
        n_l = np.clip(np.einsum("ij,ij->i", hits.normals, to_lamp), 0.0, 1.0)
        if light.shadow:
            power = power * self._visibility(light, hits, to_lamp, distance, n_l > 0, shadow_grid)
        half = unit(to_lamp + hits.views)
        n_h = np.clip(np.einsum("ij,ij->i", hits.normals, half), 0.0, 1.0)
        a2 = np.maximum(roughness, np.float32(0.12)) ** 4
        d = a2 / (np.float32(np.pi) * (n_h * n_h * (a2 - 1) + 1) ** 2)
        k = (roughness + 1) ** 2 / 8
        g = 1.0 / (4 * (n_l * (1 - k) + k) * (n_v * (1 - k) + k))
        reflected = diffuse * np.float32(1 / np.pi) + f0 * np.minimum(d * g, np.float32(40.0))[:, None]
        weight = (n_l * power * np.float32(np.pi)).astype(np.float32)
        lit: FloatArray = reflected * weight[:, None] * np.asarray(light.color, np.float32)
        return lit

    def _visibility(
        self,
        light: Light,
        hits: Hits,
        to_lamp: FloatArray,
        distance: FloatArray,
        lit: NDArray[np.bool_],
        shadow_grid: tuple[int, int] | None,
    ) -> FloatArray:
        """(M,) share of the lamp seen from each hit."""
        seen = np.zeros(len(hits.ray), np.float32)
        index = np.flatnonzero(lit)
        if not len(index):
            return seen
        directions = to_lamp[index]
        if light.softness > 0:
            # One ray a pixel to a point of the lamp that a fixed hash of the ray index chooses.
            spread = light.softness / (distance[index] if light.position is not None else 1.0)
            directions = directions + _jitter(hits.ray[index]) * np.asarray(spread, np.float32).reshape(-1, 1)
        origins = hits.points[index] + hits.normals[index] * np.float32(_SHADOW_OFFSET)
        reach = np.asarray(distance[index] - 2 * _SHADOW_OFFSET, np.float32)
        blocked = self.embree.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions, np.float32), dists=reach, query="OCCLUDED"
        )
        seen[index] = blocked < 0
        if shadow_grid is not None and light.softness > 0:
            image = np.zeros(shadow_grid[0] * shadow_grid[1], np.float32)
            weight = np.zeros_like(image)
            image[hits.ray[index]], weight[hits.ray[index]] = seen[index], 1.0
            weight_blurred = box_blur(weight.reshape(shadow_grid), 2)
            blurred = box_blur(image.reshape(shadow_grid), 2) / np.maximum(weight_blurred, np.float32(1e-3))
            seen[index] = blurred.reshape(-1)[hits.ray[index]]
        return seen


def unit(a: FloatArray) -> FloatArray:
    norm = np.sqrt(np.einsum("ij,ij->i", a, a))
    return a / np.maximum(norm, np.float32(1e-12))[:, None]


def _jitter(index: NDArray[np.int64]) -> FloatArray:
    """(N, 3) in the cube [-1, 1]^3, a fixed function of the index."""
    table = _jitter_table()
    return table[index % len(table)]


@lru_cache(maxsize=1)
def _jitter_table() -> FloatArray:
    """The R3 low-discrepancy sequence; its length is a prime above any image's width, so that rows differ."""
    alpha = np.array([0.8191725134, 0.6710436067, 0.5497004779])
    return (2.0 * ((np.arange(65537)[:, None] * alpha) % 1.0) - 1.0).astype(np.float32)
