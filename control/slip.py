"""The nail's protrusion from a contact, and the tool's slip in the hand from two looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform
from toolee_robot.types import InHandEstimate


def protrusion(X_base_ee: Array, X_base_wood: Array) -> float:
    """Compute the nail's protrusion from a face that rests on its head: where the face's plane cuts the nail's axis.

    Args:
        X_base_ee: Pose of the end effector at the contact in `base`, (4, 4).
        X_base_wood: Pose of the flush nail in `base`, (4, 4): origin on the wood, z into it.

    Returns:
        Height of the head over the wood [m]; negative when the head is below the surface.

    Raises:
        UserError: The face is more than 60 deg off the nail's axis.
    """
    normal, axis = X_base_ee[:3, 2], X_base_wood[:3, 2]
    cosine = float(normal @ axis)
    if not cosine > 0.5:
        raise UserError(
            "the face points away from the nail: this is no contact of face and nail", code="user.face_direction"
        )
    return -float(normal @ (X_base_ee[:3, 3] - X_base_wood[:3, 3])) / cosine


def slip(before: InHandEstimate, now: InHandEstimate) -> tuple[float, float]:
    """Compute the slip between two estimates of a tool in the hand, modulo the end effector's symmetry.

    Args:
        before: The earlier estimate.
        now: The later estimate.

    Returns:
        Distance [m] and angle [rad].

    Raises:
        UserError: The estimates are of different categories.
    """
    if before.category is not now.category:
        raise UserError(
            f"cannot compare a {before.category} with a {now.category}: look at the same end of the tool",
            code="user.different_categories",
        )
    distance = float(np.linalg.norm(now.X_hand_ee[:3, 3] - before.X_hand_ee[:3, 3]))
    angle = before.category.symmetry.rotation_error(before.X_hand_ee[:3, :3], now.X_hand_ee[:3, :3])
    return distance, angle


def merge(before: InHandEstimate, now: InHandEstimate, drift_position: float, drift_angle: float) -> InHandEstimate:
    """Fuse the estimates of two looks at a tool that may have drifted in the hand between them.

    The estimates are weighted as in a Kalman update on SO(3) x R^3, modulo the end effector's symmetry. The covariance
    is their weighted mean, since two looks at one tool share systematic errors that averaging does not reduce. Where
    they disagree by more than 3 sigma in the position or the axis, the tool has slipped by more than the drift, and
    only the new look is used.

    Args:
        before: The earlier estimate.
        now: The later estimate.
        drift_position: Standard deviation of the drift [m].
        drift_angle: Standard deviation of the rotational drift [rad].

    Returns:
        The fused estimate.

    Raises:
        UserError: The estimates are of different categories.
    """
    if before.category is not now.category:
        raise UserError(
            f"cannot merge a {before.category} with a {now.category}: look at the same end of the tool",
            code="user.different_categories",
        )
    R_before = before.X_hand_ee[:3, :3]
    R_now = now.category.symmetry.canonical(now.X_hand_ee[:3, :3], R_before)
    turn = Rotation.from_matrix(R_now @ R_before.T).as_rotvec()
    innovation = np.concatenate([now.X_hand_ee[:3, 3] - before.X_hand_ee[:3, 3], turn])
    prior = before.covariance + np.diag([drift_position**2] * 3 + [drift_angle**2] * 3)
    doubt = np.linalg.inv(prior + now.covariance)
    z = R_before[:, 2]
    across = innovation[3:] - (innovation[3:] @ z) * z
    for part, seen in ((slice(0, 3), innovation[:3]), (slice(3, 6), across)):
        if seen @ np.linalg.inv((prior + now.covariance)[part, part]) @ seen > 9.0:
            return now
    gain = prior @ doubt
    change = gain @ innovation
    R = Rotation.from_rotvec(change[3:]).as_matrix() @ R_before
    mean = (np.eye(6) - gain) @ prior + gain @ now.covariance
    return replace(now, X_hand_ee=transform(R, before.X_hand_ee[:3, 3] + change[:3]), covariance=(mean + mean.T) / 2)
