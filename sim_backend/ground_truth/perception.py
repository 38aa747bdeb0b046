"""Perception from the simulation's ground truth, for tests and the ablation only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, inverse
from toolee_robot.sim_backend.ground_truth.verdict import Truth
from toolee_robot.types import CameraError, Detection, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

_SIGMA = 1e-4
"""[m, rad] Standard deviation of the reported covariances, which must be positive."""


class PerfectPerception:
    """Replaces `ToolPerception` by the true poses, which no robot has.

    Args:
        judge: The ground truth.
    """

    def __init__(self, judge: Truth) -> None:
        self._judge = judge

    def estimate(
        self,
        frame: RgbdFrame,
        hand: HoldingHand | None = None,
        categories: Sequence[Category] = CATEGORIES,  # noqa: ARG002
    ) -> list[ToolEstimate]:
        """The true pose of the hammer's face, whether it is visible or not.

        Args:
            frame: Frame of whose time the pose is returned.
            hand: The hand that holds the tool; required, since the true pose is known in the hand.
            categories: As of `ToolPerception`; the hammer's face is given in any case.

        Returns:
            One estimate.

        Raises:
            PerceptionError: No hand is given.
        """
        if hand is None:
            raise PerceptionError("perfect perception needs the hand that holds the tool", code="perception.no_hand")
        X = hand.X_camera_hand @ self._judge.X_hand_ee(frame.stamp)
        uv = frame.intrinsics.matrix @ X[:3, 3]
        u, v = uv[:2] / uv[2]
        mask = np.zeros(frame.depth.shape, dtype=np.bool_)
        detection = Detection(Category.HAMMER_HEAD, 1.0, mask, (u - 8.0, v - 8.0, u + 8.0, v + 8.0))
        return [ToolEstimate(detection, X, np.eye(6) * _SIGMA**2, 1.0, True, "ok", trust=1.0)]

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,  # noqa: ARG002
    ) -> InHandEstimate:
        """The true in-hand pose at the last frame.

        Args:
            estimates_per_frame: Estimates of each frame.
            Xs_camera_hand: Pose of the hand in the camera, 4x4, for each frame.
            category: Category of the end effector; the hammer's face, or None.
            camera: As of `ToolPerception`; a true pose does not depend on it.

        Returns:
            The in-hand pose.

        Raises:
            PerceptionError: There is no estimate, or another category is requested.
        """
        if category not in (None, Category.HAMMER_HEAD):
            message = f"perfect perception supports the hammer's face only, not the {category}"
            raise PerceptionError(message, code="perception.category")
        frames = [(e[0], X) for e, X in zip(estimates_per_frame, Xs_camera_hand, strict=True) if e]
        if not frames:
            message = "the true face lies where a held hammer cannot have it: was the tool dropped?"
            raise PerceptionError(message, code="perception.nothing_seen")
        X_hand_ee = inverse(frames[-1][1]) @ frames[-1][0].X_camera_ee
        covariance = np.eye(6) * _SIGMA**2
        return InHandEstimate(
            Category.HAMMER_HEAD, X_hand_ee, covariance, 1.0, len(frames), len(estimates_per_frame), True, "ok"
        )
