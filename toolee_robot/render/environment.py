"""The environment's light baked into small octahedral maps, one for each of a few blur widths."""

from __future__ import annotations

import numpy as np

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
        self._maps = np.concatenate([environment.radiance(d, blur) for blur in _BLURS])

    def _cells(self, d: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.int32]]:
        a = np.abs(d)
        scale = np.float32(1.0) / np.maximum(a[:, 0] + a[:, 1] + a[:, 2], np.float32(1e-9))
        u, v = d[:, 0] * scale, d[:, 1] * scale
        below = d[:, 2] < 0
        u_folded = np.copysign(1 - np.abs(v), u)
        v_folded = np.copysign(1 - np.abs(u), v)
        u = np.where(below, u_folded, u)
        v = np.where(below, v_folded, v)
        half = np.float32(_SIZE / 2)
        i = np.clip(((u + 1) * half).astype(np.int32), 0, _SIZE - 1)
        j = np.clip(((v + 1) * half).astype(np.int32), 0, _SIZE - 1)
        cells: np.ndarray[tuple[int], np.dtype[np.int32]] = i * _SIZE + j
        return cells

    def diffuse(self, normals: FloatArray) -> FloatArray:
        """(N, 3) irradiance / pi for unit normals (N, 3), world frame."""
        return self._maps[self._cells(normals) + (len(_BLURS) - 1) * _SIZE * _SIZE]

    def specular(self, directions: FloatArray, roughness: FloatArray) -> FloatArray:
        """(N, 3) light reflected towards the eye from unit mirror directions (N, 3), world frame."""
        level = np.clip(
            (roughness * np.float32(len(_BLURS) - 1) + np.float32(0.5)).astype(np.int32), 0, len(_BLURS) - 1
        )
        return self._maps[self._cells(directions) + level * (_SIZE * _SIZE)]
