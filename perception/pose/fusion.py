"""Fusion of several views of a tool that does not move in the hand into one pose in the hand frame.

Robust iteratively reweighted least squares: frames outside of the largest consensus are dropped, the others weighted by
their information with a Cauchy loss, modulo the symmetry group. The covariance has a floor: frames share the camera's
calibration and the network's bias, so that more of them do not make the result exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.perception.pose.pooling import FREE_SPIN_VARIANCE, align, pairwise_angles
from toolee_robot.perception.pose.spin import with_spin_variance
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind
from toolee_robot.types import InHandEstimate

FLOOR_POSITION = 0.0010
"""Systematic position error [m] per axis that no number of frames removes."""
FLOOR_ANGLE = np.deg2rad(0.8)
"""Systematic angular error [rad] per axis that no number of frames removes."""
CORRELATION = 0.4
"""Share of the error that is common to all frames: errors of neighbouring views are correlated."""
INLIER_ANGLE = np.deg2rad(15.0)
"""Frames whose poses differ by less [rad], modulo the symmetry, agree."""
INLIER_DISTANCE = 0.015
"""Frames whose positions differ by less [m] agree."""


class FrameEstimate(Protocol):
    """The part of a frame's estimate that fusion needs; `ToolEstimate` and `PoseResult` have it.

    Attributes:
        category: Category of the end effector.
        X_camera_ee: Its pose, 4x4; NaN where there is none.
        covariance: 6x6, position [m] then rotation vector [rad], camera axes.
        confidence: Probability in [0, 1] that the pose is right.
        usable: Whether the pose may be acted on.
    """

    @property
    def category(self) -> Category: ...
    @property
    def X_camera_ee(self) -> Array: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def confidence(self) -> float: ...
    @property
    def usable(self) -> bool: ...


def fuse_in_hand(
    estimates: Sequence[FrameEstimate], Xs_camera_hand: Sequence[Array], min_frames: int = 2
) -> InHandEstimate:
    """Fuse the estimates of one end effector from several frames.

    Frames that are not usable are counted as seen, but only used when no frame is usable.

    Args:
        estimates: One estimate per frame, all of one category.
        Xs_camera_hand: Pose of the hand in the camera frame, 4x4, at the exposure of each frame.
        min_frames: Frames that must agree for the result to be usable, besides more than half of the usable ones.

    Returns:
        The pose in the hand frame with its covariance; `usable` and `reason` say whether it may be acted on.

    Raises:
        PerceptionError: There is no frame, or none has a pose.
        ValueError: The numbers of estimates and of hand poses differ.
    """
    if not estimates:
        raise PerceptionError("no frame shows the tool: move it into the camera's view", code="perception.no_frames")
    if len(estimates) != len(Xs_camera_hand):
        raise ValueError(f"{len(estimates)} estimates but {len(Xs_camera_hand)} hand poses")
    category = estimates[0].category
    group = category.symmetry
    pairs = [(e, X) for e, X in zip(estimates, Xs_camera_hand, strict=True) if np.isfinite(e.X_camera_ee).all()]
    if not pairs:
        raise PerceptionError(
            f"no frame shows the {category} well enough: move it closer to the camera, unoccluded",
            code="perception.not_seen",
        )
    trusted = [pair for pair in pairs if pair[0].usable] or pairs
    Xs = np.stack([inverse(X_camera_hand) @ e.X_camera_ee for e, X_camera_hand in trusted])
    covariances = np.stack([_in_hand(e.covariance, X) for e, X in trusted])
    confidence = np.clip([e.confidence for e, _ in trusted], 1e-3, 1.0)

    # Where the spin is known, rotations are compared in full; otherwise modulo the group.
    axes = Xs[:, :3, :3] @ np.asarray(group.axis)
    spin = np.einsum("fi,fij,fj->f", axes, covariances[:, 3:, 3:], axes)
    if group.kind is SymmetryKind.CINF and float(np.median(spin)) < 0.15 * FREE_SPIN_VARIANCE:
        group = SymmetryGroup(SymmetryKind.NONE)
    inliers = _consensus(Xs, group, confidence)
    Xs, covariances, confidence = Xs[inliers], covariances[inliers], confidence[inliers]

    aligned = align(Xs[:, :3, :3], Xs[int(np.argmax(confidence)), :3, :3], group)
    R, p = aligned[int(np.argmax(confidence))], np.median(Xs[:, :3, 3], axis=0)
    floor = np.diag([FLOOR_POSITION**2] * 3 + [FLOOR_ANGLE**2] * 3)
    information = np.linalg.inv(covariances + floor)
    total, weight, squared = np.eye(6), np.ones(len(Xs)), np.zeros(len(Xs))
    for _ in range(6):
        aligned = align(aligned, R, group)
        residual = np.concatenate([Xs[:, :3, 3] - p, Rotation.from_matrix(aligned @ R.T).as_rotvec()], axis=1)
        squared = np.einsum("fi,fij,fj->f", residual, information, residual)
        weight = 1 / (1 + squared / 12.0)  # Cauchy, 6 degrees of freedom
        total = np.einsum("f,fij->ij", weight, information)
        step = np.linalg.solve(total, np.einsum("f,fij,fj->i", weight, information, residual))
        p = p + step[:3]
        R = Rotation.from_rotvec(step[3:]).as_matrix() @ R

    n = len(Xs)
    mean = np.linalg.inv(total) * n
    # Scatter beyond the covariances inflates the result; less scatter does not shrink it (frames are correlated).
    inflation = max(1.0, float(squared.sum()) / max(6 * (n - 1), 1)) if n > 1 else 1.0
    covariance = mean * inflation * (CORRELATION + (1 - CORRELATION) / n) + floor
    if group.kind is SymmetryKind.CINF:
        # The frames' axes differ slightly, so that swing information would leak into the unobserved spin.
        axis = R @ np.asarray(group.axis)
        covariance = with_spin_variance(covariance, axis, min(float(np.median(spin)), FREE_SPIN_VARIANCE))
    agreeing = n / len(trusted)
    usable_seen = sum(e.usable for e in estimates)
    belief = float((1 - (1 - confidence.mean()) ** (1 + 0.5 * (n - 1))) * agreeing)
    if usable_seen < min(min_frames, len(estimates)):
        usable, reason = False, f"only {usable_seen} of {len(estimates)} frames show the {category} well enough"
    elif n < min(min_frames, len(estimates)) or agreeing <= 0.5:
        usable, reason = False, f"the frames disagree: {n} of {len(trusted)} agree on a pose of the {category}"
    else:
        usable, reason = True, "ok"
    return InHandEstimate(category, transform(R, p), covariance, belief, n, len(estimates), usable, reason)


def _in_hand(covariance: Array, X_camera_hand: Array) -> Array:
    """Rotate a 6x6 covariance from camera axes to hand axes."""
    J = np.kron(np.eye(2), X_camera_hand[:3, :3].T)
    return J @ covariance @ J.T


def _consensus(Xs: Array, group: SymmetryGroup, confidence: Array) -> NDArray[np.intp]:
    """Indices of the largest set of frames (by confidence) that agree with one of them."""
    angle = pairwise_angles(Xs[:, :3, :3], group)
    distance = np.linalg.norm(Xs[:, None, :3, 3] - Xs[None, :, :3, 3], axis=-1)
    agree = (angle < INLIER_ANGLE) & (distance < INLIER_DISTANCE)
    # Among equal sets, the tightest centre.
    score = agree @ confidence - 1e-3 * np.where(agree, angle + distance / INLIER_DISTANCE * INLIER_ANGLE, 0).sum(1)
    return np.flatnonzero(agree[int(np.argmax(score))])
