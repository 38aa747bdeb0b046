"""Where in front of the hand the held tool is looked for."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array, transform_points
from toolee_robot.station import StationConfig
from toolee_robot.types import HeldRegion

POSE_ERRORS = 3.0
"""The hand's pose in the camera's frame is taken to be within so many times the calibration's residual, its root mean
square error across the line of sight on held-out poses of the arm: a Gaussian error is in all but 1 of 8,000 frames."""


def held_region(config: StationConfig, X_hand_ee: Array, displacement: float) -> HeldRegion:
    """The part of space, fixed to the hand, that holds the tool from its head to the hand.

    The hull of the head's axis and the hand's origin, widened by the tool's thickness, by how far the end effector may
    be from its nominal place in the hand, and by how far the hand may be from where kinematics and calibration have it.

    Args:
        config: The station, with the tool's envelope and the residual of the camera's calibration.
        X_hand_ee: Nominal pose of the end effector in the hand, (4, 4).
        displacement: Largest distance of the end effector from its nominal place in the hand [m].

    Returns:
        The region.
    """
    envelope = config.tool_envelope
    head = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -envelope.head_length]])
    thickness = max(envelope.head_radius, envelope.handle_radius)
    residual = 0.0 if config.calibration is None else config.calibration.residual
    points = np.vstack([transform_points(X_hand_ee, head), np.zeros(3)])
    return HeldRegion(points, thickness + displacement + POSE_ERRORS * residual)
