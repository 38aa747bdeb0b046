"""What a contact and two looks at the tool tell: how far the nail stands out, how far the tool slipped in the hand."""

from __future__ import annotations

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
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
