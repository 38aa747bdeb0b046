"""Rotational symmetry groups of end effectors, and the rotation error modulo such a group.

The group, not a network's opinion of it, decides every metric here.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, angle_between, rotation_angle


class SymmetryKind(StrEnum):
    """none: identity only. C2: {I, rotation by pi} about the axis. Cinf: all rotations about the axis."""

    NONE = "none"
    C2 = "C2"
    CINF = "Cinf"


@dataclass(frozen=True)
class SymmetryGroup:
    """Rotations g with X_A_ee @ g indistinguishable from X_A_ee; `axis` (3,) is a unit vector in the EE frame."""

    kind: SymmetryKind
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def elements(self, steps: int = 64) -> Array:
        """The group's rotations, (G, 3, 3), read-only; a continuous group is sampled in `steps` equal steps."""
        n = {SymmetryKind.NONE: 1, SymmetryKind.C2: 2, SymmetryKind.CINF: steps}[self.kind]
        return _turns(self.axis, n)

    def rotation_error(self, R_a: Array, R_b: Array) -> float:
        """Smallest angle [rad] between R_a and R_b @ g over the group; exact for the continuous group too."""
        if self.kind is SymmetryKind.CINF:
            axis = np.asarray(self.axis)
            return angle_between(R_a @ axis, R_b @ axis)
        return min(rotation_angle(R_a.T @ R_b @ g) for g in self.elements())

    def canonical(self, R: Array, R_reference: Array) -> Array:
        """The member of R's orbit {R @ g} closest to R_reference (3x3)."""
        if self.kind is SymmetryKind.CINF:
            # Twist about the axis that best aligns R with the reference: swing-twist of R^T R_ref.
            axis = np.asarray(self.axis)
            qx, qy, qz, qw = Rotation.from_matrix(R.T @ R_reference).as_quat()
            angle = 2 * np.arctan2(np.dot([qx, qy, qz], axis), qw)
            return R @ Rotation.from_rotvec(angle * axis).as_matrix()
        candidates = [R @ g for g in self.elements()]
        return min(candidates, key=lambda C: rotation_angle(C.T @ R_reference))


@cache
def _turns(axis: tuple[float, float, float], n: int) -> Array:
    """(n, 3, 3): rotations about `axis` by n equal steps. Every comparison of two poses asks for the same ones."""
    angles = 2 * np.pi * np.arange(n) / n
    turns: Array = Rotation.from_rotvec(angles[:, None] * np.asarray(axis)).as_matrix()
    turns.setflags(write=False)
    return turns
