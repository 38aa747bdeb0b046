"""pybullet without its output on the standard streams.

from toolee_robot.sim_backend.physics.bullet import pb
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from toolee_robot.frames import Array


@contextmanager
def quiet(descriptor: int) -> Iterator[None]:
    """Discard output to a file descriptor, including that of C libraries.

    Args:
        descriptor: 1 for standard output, 2 for standard error.
    """
    (sys.stdout if descriptor == 1 else sys.stderr).flush()
    c_library = ctypes.CDLL(None)  # C streams have their own buffers
    c_library.fflush(None)
    kept = os.dup(descriptor)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, descriptor)
        yield
    finally:
        c_library.fflush(None)
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)


with quiet(2):
    import pybullet as pb

__all__ = ["pb", "pose_matrix", "quiet", "rotation_matrix"]


def rotation_matrix(quaternion: tuple[float, ...]) -> Array:
    """Rotation matrix (3, 3) of a quaternion (x, y, z, w)."""
    return np.array(pb.getMatrixFromQuaternion(quaternion)).reshape(3, 3)


def pose_matrix(position: tuple[float, ...], quaternion: tuple[float, ...]) -> Array:
    """Build a pose from what pybullet reports.

    Args:
        position: Position [m].
        quaternion: Orientation (x, y, z, w).

    Returns:
        The pose, (4, 4).
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = pb.getMatrixFromQuaternion(quaternion)
    x, y, z = position
    return np.array([[xx, xy, xz, x], [yx, yy, yz, y], [zx, zy, zz, z], [0.0, 0.0, 0.0, 1.0]])
