"""What a contact and two looks at the tool tell: how far the nail stands out, how far the tool slipped in the hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform
from toolee_robot.types import InHandEstimate


def protrusion(X_base_ee: Array, X_base_wood: Array) -> float:
    """Length [m] of the nail over the wood from a face that rests on it: where the face's plane cuts the nail's axis.

    X_base_ee: 4x4, the EE at contact (forward kinematics and X_hand_ee). X_base_wood: 4x4, the nail's frame as it will
    be when the head is flush: origin on the wood, z into it. Negative once the head is under the surface.
    Raises UserError when the face is more than 60 deg off the nail's axis.
    """
    normal, axis = X_base_ee[:3, 2], X_base_wood[:3, 2]
    cosine = float(normal @ axis)
    if not cosine > 0.5:
        raise UserError("the face points away from the nail: this is no contact of face and nail")
    return -float(normal @ (X_base_ee[:3, 3] - X_base_wood[:3, 3])) / cosine


def slip(before: InHandEstimate, now: InHandEstimate) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two estimates of the same tool in the hand, modulo the EE's symmetry.

    Raises UserError when they are of different categories.
    """
    if before.category is not now.category:
        raise UserError(f"cannot compare a {before.category} with a {now.category}: look at the same end of the tool")
    distance = float(np.linalg.norm(now.X_hand_ee[:3, 3] - before.X_hand_ee[:3, 3]))
    angle = before.category.symmetry.rotation_error(before.X_hand_ee[:3, :3], now.X_hand_ee[:3, :3])
    return distance, angle


def merge(before: InHandEstimate, now: InHandEstimate, drift_position: float, drift_angle: float) -> InHandEstimate:
    """What an earlier look and a new one say together, for a tool that may have drifted in the hand between them.

    drift_position [m], drift_angle [rad]: standard deviations of the drift. The two are weighted as in a Kalman update
    (on SO(3) x R^3, modulo the EE's symmetry), but the covariance is the weighted mean of theirs: two looks at one tool
    share their systematic error, and averaging does not take that away. Where they disagree by more than 3 sigma in the
    place or the axis, the tool has slipped more than it drifts, and the new look counts alone.
    Raises UserError when they are of different categories.
    """
    if before.category is not now.category:
        raise UserError(f"cannot merge a {before.category} with a {now.category}: look at the same end of the tool")
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
