"""The paper's pooling: the mean of all candidates, without outliers or modes."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose.pooling import align
from toolee_robot.symmetry import SymmetryGroup


def mean_pose(Xs: Array, group: SymmetryGroup | None = None) -> Array:
    """Mean of poses.

    The largest eigenvector of the quaternions' second moments (Markley et al., 2007) and the arithmetic mean of the
    positions.

    Args:
        Xs: Poses (K, 4, 4).
        group: A known symmetry, modulo which the rotations are first aligned to the first one.

    Returns:
        The mean, 4x4.
    """
    R = Xs[:, :3, :3]
    if group is not None:
        R = align(R, R[0], group)
    q = Rotation.from_matrix(R).as_quat()
    vectors = np.linalg.eigh(q.T @ q)[1]
    return transform(Rotation.from_quat(vectors[:, -1]), Xs[:, :3, 3].mean(0))
