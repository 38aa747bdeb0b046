"""The environment's light baked into small octahedral maps, one for each of a few blur widths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.scene import Environment

_SIZE = 64
_BLURS = (0.05, 0.25, 0.6, 1.0)
"""Half-widths [rad] of the maps; the last one serves as the diffuse irradiance."""


class EnvironmentMap:
    """Look-up of an `Environment` by direction and roughness."""

    def __init__(self, environment: Environment) -> None:
        cell = (np.arange(_SIZE) + 0.5) / _SIZE * 2 - 1
        u, v = (a.reshape(-1) for a in np.meshgrid(cell, cell, indexing="ij"))
        z = 1 - np.abs(u) - np.abs(v)
        fold = np.maximum(-z, 0)
        d = np.column_stack([u - np.sign(u) * fold, v - np.sign(v) * fold, z])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        self._maps = np.ascontiguousarray(np.concatenate([environment.radiance(d, blur) for blur in _BLURS]).T)

    def _cells(self, d: FloatArray) -> NDArray[np.int32]:
        a = np.abs(d)
        scale = np.float32(1.0) / np.maximum(a[0] + a[1] + a[2], np.float32(1e-9))
        u, v = d[0] * scale, d[1] * scale
        below = np.flatnonzero(d[2] < 0)
        folded_u, folded_v = u[below], v[below]
        u[below] = np.copysign(1 - np.abs(folded_v), folded_u)
        v[below] = np.copysign(1 - np.abs(folded_u), folded_v)
        half = np.float32(_SIZE / 2)
        i = np.minimum(((u + 1) * half).astype(np.int32), _SIZE - 1)
        j = np.minimum(((v + 1) * half).astype(np.int32), _SIZE - 1)
        return np.maximum(i * _SIZE + j, 0)

    def diffuse(self, normals: FloatArray) -> FloatArray:
        """(3, N) irradiance / pi for unit normals (3, N), world frame."""
        return self._maps.take(self._cells(normals) + (len(_BLURS) - 1) * _SIZE * _SIZE, axis=1)

    def specular(self, directions: FloatArray, roughness: FloatArray | float) -> FloatArray:
        """(3, N) light reflected towards the eye from unit mirror directions (3, N), world frame; roughness (N,)."""
        level = (np.asarray(roughness, np.float32) * np.float32(len(_BLURS) - 1) + np.float32(0.5)).astype(np.int32)
        return self._maps.take(self._cells(directions) + level.clip(0, len(_BLURS) - 1) * (_SIZE * _SIZE), axis=1)
