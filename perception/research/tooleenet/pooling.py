"""The paper's pooling: the mean of all candidates, without a look at outliers or modes."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose.pooling import align
from toolee_robot.symmetry import SymmetryGroup


def mean_pose(Xs: Array, group: SymmetryGroup | None = None) -> Array:
    """4x4 mean of poses (K, 4, 4): the largest eigenvector of the quaternions' second moments (Markley et al., 2007)
    and the arithmetic mean of the positions. group: a symmetry known beforehand, modulo which the rotations are first
    aligned to the first one."""
    R = Xs[:, :3, :3]
    if group is not None:
        R = align(R, R[0], group)
    q = Rotation.from_matrix(R).as_quat()
    vectors = np.linalg.eigh(q.T @ q)[1]
    return transform(Rotation.from_quat(vectors[:, -1]), Xs[:, :3, 3].mean(0))
