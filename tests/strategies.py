"""Hypothesis strategies for rigid transforms."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform

_component = st.floats(-1.0, 1.0, allow_nan=False)


def rotations() -> st.SearchStrategy[Array]:
    """Rotation matrices (3, 3), angles from 0 to pi included."""

    def build(x: float, y: float, z: float, angle: float) -> Array:
        axis = np.array([x, y, z])
        norm = np.linalg.norm(axis)
        axis = axis / norm if norm > 1e-3 else np.array([0.0, 0.0, 1.0])
        return Rotation.from_rotvec(angle * axis).as_matrix()

    return st.builds(build, _component, _component, _component, st.floats(0.0, np.pi))


def transforms() -> st.SearchStrategy[Array]:
    """Rigid transforms (4, 4) with positions within a metre."""
    return st.builds(lambda R, p: transform(R, p), rotations(), st.tuples(_component, _component, _component))
