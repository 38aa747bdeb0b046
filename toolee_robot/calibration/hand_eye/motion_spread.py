"""Whether the arm's poses determine a hand-eye calibration: rotations about two axes or more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.errors import UserError
from toolee_robot.frames import Array

MIN_POSES = 8
"""Fewest poses of a calibration."""
MIN_ROTATION = np.deg2rad(25.0)
"""Least rotation between two poses, about each of two axes at right angles to each other [rad]."""


@dataclass(frozen=True, eq=False)
class MotionSpread:
    """Rotations between the poses of the flange.

    Attributes:
        first: Largest rotation between two poses [rad].
        axis: Its axis in the flange, (3,).
        second: Largest rotation between two poses about an axis at a right angle to `axis` [rad]: the part of their
            rotation vector there.
    """

    first: float
    axis: Array
    second: float

    @property
    def sufficient(self) -> bool:
        """Whether both rotations are large enough."""
        return min(self.first, self.second) >= MIN_ROTATION


def motion_spread(Xs_base_flange: Sequence[Array]) -> MotionSpread:
    """Measure the rotations between poses.

    The translation of a hand-eye calibration is undetermined along the axis of all rotations where they share one
    (Tsai and Lenz, 1989).

    Args:
        Xs_base_flange: Poses of the flange, (4, 4) each, two or more.

    Returns:
        The rotations.
    """
    R = Rotation.from_matrix(np.asarray(Xs_base_flange)[:, :3, :3])
    i, j = np.triu_indices(len(Xs_base_flange), 1)
    vectors = (R[i].inv() * R[j]).as_rotvec()
    angles = np.linalg.norm(vectors, axis=1)
    largest = int(np.argmax(angles))
    axis = vectors[largest] / max(angles[largest], 1e-12)
    across = vectors - np.outer(vectors @ axis, axis)
    return MotionSpread(float(angles[largest]), axis, float(np.linalg.norm(across, axis=1).max()))


def check_motion(Xs_base_flange: Sequence[Array]) -> MotionSpread:
    """Refuse poses that do not determine a calibration.

    Args:
        Xs_base_flange: Poses of the flange, (4, 4) each.

    Returns:
        The rotations between them.

    Raises:
        UserError: There are too few, or they turn the board too little or about one axis only.
    """
    if len(Xs_base_flange) < MIN_POSES:
        raise UserError(
            f"{len(Xs_base_flange)} poses show the board: give {MIN_POSES} or more, better 20",
            code="user.calibration_few_poses",
        )
    spread = motion_spread(Xs_base_flange)
    if not spread.sufficient:
        raise UserError(
            f"the poses turn the board by at most {np.rad2deg(spread.first):.0f}° about one axis and "
            f"{np.rad2deg(spread.second):.0f}° about any axis across it; {np.rad2deg(MIN_ROTATION):.0f}° about both "
            "are needed, or the camera's place is undetermined: tilt the board left, right, up and down, and turn it",
            code="user.calibration_degenerate",
        )
    return spread
