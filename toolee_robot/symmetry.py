"""Rotational symmetry groups of end effectors, and the rotation error modulo such a group.

The group is part of a category's specification and decides every metric; networks do not estimate it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, angle_between, rotation_angle


class SymmetryKind(StrEnum):
    """Kinds of groups: the identity only, C2 {I, rotation by pi}, Cinf all rotations about the axis."""

    NONE = "none"
    C2 = "C2"
    CINF = "Cinf"


@dataclass(frozen=True)
class SymmetryGroup:
    """Group of the rotations g for which X_A_ee @ g is indistinguishable from X_A_ee.

    Attributes:
        kind: Kind of the group.
        axis: Symmetry axis, a unit vector in the EE frame, (3,).
    """

    kind: SymmetryKind
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def elements(self, steps: int = 64) -> Array:
        """Return the rotations of the group.

        Args:
            steps: Number of equal steps in which a continuous group is sampled.

        Returns:
            The rotations, (G, 3, 3), read-only.
        """
        n = {SymmetryKind.NONE: 1, SymmetryKind.C2: 2, SymmetryKind.CINF: steps}[self.kind]
        return _rotations(self.axis, n)

    def rotation_error(self, R_a: Array, R_b: Array) -> float:
        """Smallest angle between R_a and R_b @ g over the group; exact for the continuous group too.

        Args:
            R_a: First rotation, (3, 3).
            R_b: Second rotation, (3, 3).

        Returns:
            The angle [rad].
        """
        if self.kind is SymmetryKind.CINF:
            axis = np.asarray(self.axis)
            return angle_between(R_a @ axis, R_b @ axis)
        return min(rotation_angle(R_a.T @ R_b @ g) for g in self.elements())

    def canonical(self, R: Array, R_reference: Array) -> Array:
        """Return the member of the orbit {R @ g} closest to a reference.

        Args:
            R: Rotation, (3, 3).
            R_reference: Reference rotation, (3, 3).

        Returns:
            The member of the orbit, (3, 3).
        """
        if self.kind is SymmetryKind.CINF:
            # Twist about the axis that best aligns R with the reference: swing-twist of R^T R_ref.
            axis = np.asarray(self.axis)
            qx, qy, qz, qw = Rotation.from_matrix(R.T @ R_reference).as_quat()
            angle = 2 * np.arctan2(np.dot([qx, qy, qz], axis), qw)
            return R @ Rotation.from_rotvec(angle * axis).as_matrix()
        candidates = [R @ g for g in self.elements()]
        return min(candidates, key=lambda C: rotation_angle(C.T @ R_reference))


@cache
def _rotations(axis: tuple[float, float, float], n: int) -> Array:
    """Rotations about `axis` by n equal steps, (n, 3, 3); cached because every pose comparison uses them."""
    angles = 2 * np.pi * np.arange(n) / n
    rotations: Array = Rotation.from_rotvec(angles[:, None] * np.asarray(axis)).as_matrix()
    rotations.setflags(write=False)
    return rotations
