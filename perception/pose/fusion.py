"""Fusion of several views of a tool that does not move in the hand into one pose in the hand frame.

Robust iteratively reweighted least squares: frames outside of the largest consensus are dropped, the others weighted by
their information with a Cauchy loss, modulo the symmetry group. The camera is not where its calibration has it: an
error that all frames share displaces the tool by the same vector in the camera, which is another one in the hand for
every orientation of the hand. It is estimated together with the pose, as in hand-eye calibration with the tool for a
target, and tells apart from the tool's pose what turns with the hand. The covariance has a floor: frames share the
network's bias, so that more of them do not make the result exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, inverse, skew, transform
from toolee_robot.perception.pose.pooling import FREE_SPIN_VARIANCE, align, pairwise_angles, with_spin_variance
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind
from toolee_robot.types import CameraError, InHandEstimate

FLOOR_POSITION = 0.0010
"""Systematic position error [m] per axis that no number of frames removes."""
FLOOR_ANGLE = np.deg2rad(0.8)
"""Systematic angular error [rad] per axis that no number of frames removes."""
CORRELATION = 0.4
"""Share of the error that is common to all frames: errors of neighbouring views are correlated."""
INLIER_ANGLE = np.deg2rad(15.0)
"""Frames whose poses differ by less [rad], modulo the symmetry, agree."""
INLIER_DISTANCE = 0.015
"""Frames whose positions differ by less [m] agree, once the camera's error is taken out."""
MOVED_DISTANCE = 0.055
"""Frames whose positions differ by less [m] may agree if the camera was moved since its calibration."""
UNKNOWN_CAMERA = CameraError(np.zeros(6), np.diag([0.003**2] * 3 + [np.deg2rad(0.4) ** 2] * 3))
"""What is believed of a camera before a tool was seen with it: what eye-to-hand calibrations leave (0.7 to 3.2 mm at
1 m). Its tails are those of the frames' loss, so that one that was moved is found, too. Chosen on 63 looks: research
log, 2026-11-27."""
ELSEWHERE = np.diag([0.001**2] * 3 + [np.deg2rad(0.1) ** 2] * 3)
"""What an arm's own errors, which differ from place to place, add to the camera's between two looks. Assumed."""


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
    estimates: Sequence[FrameEstimate],
    Xs_camera_hand: Sequence[Array],
    min_frames: int = 2,
    camera: CameraError = UNKNOWN_CAMERA,
) -> InHandEstimate:
    """Fuse the estimates of one end effector from several frames.

    Frames that are not usable are counted as seen, but only used when no frame is usable.

    Args:
        estimates: One estimate per frame, all of one category.
        Xs_camera_hand: Pose of the hand in the camera frame, 4x4, at the exposure of each frame, by the calibration.
        min_frames: Frames that must agree for the result to be usable, besides more than half of the usable ones.
        camera: What is known of the calibration's error, from an earlier look with the same camera.

    Returns:
        The pose in the hand frame with its covariance, and the camera's error; `usable` and `reason` say whether it may
        be acted on.

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
            f"no frame shows the {category.label} well enough: move it closer to the camera, unoccluded",
            code="perception.not_seen",
        )
    trusted = [pair for pair in pairs if pair[0].usable] or pairs
    frames = _Frames(
        np.stack([inverse(X_camera_hand) @ e.X_camera_ee for e, X_camera_hand in trusted]),
        np.stack([_in_hand(e.covariance, X) for e, X in trusted]),
        np.stack([_by_camera(e.X_camera_ee[:3, 3], X) for e, X in trusted]),
        np.clip([e.confidence for e, _ in trusted], 1e-3, 1.0),
    )

    # Where the spin is known, rotations are compared in full; otherwise modulo the group.
    axes = frames.Xs[:, :3, :3] @ np.asarray(group.axis)
    spin = np.einsum("fi,fij,fj->f", axes, frames.covariances[:, 3:, 3:], axes)
    if group.kind is SymmetryKind.CINF and float(np.median(spin)) < 0.15 * FREE_SPIN_VARIANCE:
        group = SymmetryGroup(SymmetryKind.NONE)
    # First those that agree if the camera may be off, then those that do with its error taken out.
    agreeing = _consensus(frames.corrected(camera.mean), group, frames.confidence, MOVED_DISTANCE)
    error = _solve(frames.only(agreeing), group, camera).camera.mean
    agreeing = _consensus(frames.corrected(error), group, frames.confidence, INLIER_DISTANCE)
    frames = frames.only(agreeing)
    solution = _solve(frames, group, camera)

    n, R = len(agreeing), solution.X[:3, :3]
    covariance = solution.covariance
    if group.kind is SymmetryKind.CINF:
        # The frames' axes differ slightly, so that swing information would leak into the unobserved spin.
        axis = R @ np.asarray(group.axis)
        free = min(float(np.median(spin[agreeing])), FREE_SPIN_VARIANCE)
        covariance = with_spin_variance(covariance, axis, free)
    share = n / len(trusted)
    usable_seen = sum(e.usable for e in estimates)
    belief = float((1 - (1 - frames.confidence.mean()) ** (1 + 0.5 * (n - 1))) * share)
    if usable_seen < min(min_frames, len(estimates)):
        usable, reason = False, f"only {usable_seen} of {len(estimates)} frames show the {category.label} well enough"
    elif n < min(min_frames, len(estimates)) or share <= 0.5:
        usable, reason = False, f"the frames disagree: {n} of {len(trusted)} agree on a pose of the {category.label}"
    else:
        usable, reason = True, "ok"
    return InHandEstimate(category, solution.X, covariance, belief, n, len(estimates), usable, reason, solution.camera)


@dataclass(frozen=True)
class _Frames:
    """What the frames tell of the tool.

    Attributes:
        Xs: Its poses in the hand, by the calibration, (F, 4, 4).
        covariances: Their covariances, hand's axes, (F, 6, 6).
        by_camera: How they change with the camera's error, (F, 6, 6).
        confidence: How likely each is right, (F,).
    """

    Xs: Array
    covariances: Array
    by_camera: Array
    confidence: Array

    def only(self, rows: NDArray[np.intp]) -> _Frames:
        """Some of the frames."""
        return _Frames(self.Xs[rows], self.covariances[rows], self.by_camera[rows], self.confidence[rows])

    def corrected(self, error: Array) -> Array:
        """The poses without an error of the camera, (F, 4, 4)."""
        off = self.by_camera @ error
        R = Rotation.from_rotvec(-off[:, 3:]).as_matrix() @ self.Xs[:, :3, :3]
        return np.stack([transform(R[i], X[:3, 3] - off[i, :3]) for i, X in enumerate(self.Xs)])


@dataclass(frozen=True)
class _Solution:
    """What explains the frames best.

    Attributes:
        X: Pose of the tool in the hand, (4, 4).
        covariance: Its covariance, hand's axes, (6, 6).
        camera: The camera's error.
    """

    X: Array
    covariance: Array
    camera: CameraError


def _solve(frames: _Frames, group: SymmetryGroup, camera: CameraError) -> _Solution:
    """The pose and the camera's error that explain the frames best, with their covariances."""
    n, best = len(frames.Xs), int(np.argmax(frames.confidence))
    floor = np.diag([FLOOR_POSITION**2] * 3 + [FLOOR_ANGLE**2] * 3)
    information = np.linalg.inv(frames.covariances + floor)
    J = np.concatenate([np.broadcast_to(np.eye(6), (n, 6, 6)), frames.by_camera], axis=-1)
    known, prior = np.linalg.inv(camera.covariance), np.zeros((12, 12))
    Xs = frames.corrected(camera.mean)
    aligned = align(Xs[:, :3, :3], Xs[best, :3, :3], group)
    R, p, error = aligned[best], np.median(Xs[:, :3, 3], axis=0), camera.mean
    total, squared = np.eye(12), np.zeros(n)
    for _ in range(15):
        Xs = frames.corrected(error)
        aligned = align(Xs[:, :3, :3], R, group)
        residual = np.concatenate([Xs[:, :3, 3] - p, Rotation.from_matrix(aligned @ R.T).as_rotvec()], axis=1)
        squared = np.einsum("fi,fij,fj->f", residual, information, residual)
        weight = 1 / (1 + squared / 12.0)  # Cauchy, 6 degrees of freedom
        total = np.einsum("f,fia,fij,fjb->ab", weight, J, information, J)
        right = np.einsum("f,fia,fij,fj->a", weight, J, information, residual)
        # The same loss, so that a camera that was moved far is found.
        off = error - camera.mean
        prior[6:, 6:] = known / (1 + off @ known @ off / 6.0)
        right[6:] -= prior[6:, 6:] @ off
        step = np.linalg.solve(total + prior, right)
        p, error = p + step[:3], error + step[6:]
        R = Rotation.from_rotvec(step[3:6]).as_matrix() @ R
    # Scatter beyond the covariances inflates the result; less scatter does not shrink it (frames are correlated).
    inflation = max(1.0, float(squared.sum()) / max(6 * (n - 1), 1)) if n > 1 else 1.0
    covariance = np.linalg.inv(total / inflation + prior)
    # What the network makes of a tool in every frame moves with the hand: it is in the pose, not in the camera's error.
    common = CORRELATION * inflation * n * np.linalg.inv(total[:6, :6])
    found = CameraError(error, np.asarray(covariance[6:, 6:] + ELSEWHERE))
    return _Solution(transform(R, p), covariance[:6, :6] + common + floor, found)


def _by_camera(p_camera: Array, X_camera_hand: Array) -> Array:
    """How a pose in the hand changes with the camera's error, (6, 6): that of a point in the camera, turned."""
    R = X_camera_hand[:3, :3].T
    return np.block([[R, -R @ skew(p_camera)], [np.zeros((3, 3)), R]])


def _in_hand(covariance: Array, X_camera_hand: Array) -> Array:
    """Rotate a 6x6 covariance from camera axes to hand axes."""
    J = np.kron(np.eye(2), X_camera_hand[:3, :3].T)
    return J @ covariance @ J.T


def _consensus(Xs: Array, group: SymmetryGroup, confidence: Array, within: float) -> NDArray[np.intp]:
    """Indices of the largest set of frames (by confidence) that agree with one of them, their places within [m]."""
    angle = pairwise_angles(Xs[:, :3, :3], group)
    distance = np.linalg.norm(Xs[:, None, :3, 3] - Xs[None, :, :3, 3], axis=-1)
    agree = (angle < INLIER_ANGLE) & (distance < within)
    # Among equal sets, the tightest centre.
    score = agree @ confidence - 1e-3 * np.where(agree, angle + distance / within * INLIER_ANGLE, 0).sum(1)
    return np.flatnonzero(agree[int(np.argmax(score))])
