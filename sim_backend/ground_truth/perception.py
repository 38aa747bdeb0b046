"""The perfect-perception mode: poses from the simulation's ground truth, for tests and the ablation only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, inverse
from toolee_robot.sim_backend.ground_truth.verdict import Truth
from toolee_robot.types import Detection, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

_SIGMA = 1e-4
"""Claimed standard deviation [m, rad]: none, but covariances must be positive."""


class PerfectPerception:
    """Stands where ToolPerception stands and tells the truth. Never what a robot could do."""

    def __init__(self, judge: Truth) -> None:
        self._judge = judge

    def estimate(self, frame: RgbdFrame, hand: HoldingHand | None = None) -> list[ToolEstimate]:
        """One estimate: the true face, seen or not. The hand's pose is needed: truth is told in the hand."""
        if hand is None:
            raise PerceptionError("perfect perception is told in the hand's frame: give the hand")
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
    ) -> InHandEstimate:
        """The last frame's truth in the hand."""
        if category not in (None, Category.HAMMER_HEAD):
            raise PerceptionError(f"perfect perception knows the hammer's face only, not the {category}")
        told = [(e[0], X) for e, X in zip(estimates_per_frame, Xs_camera_hand, strict=True) if e]
        if not told:
            raise PerceptionError("the true face lies where a held hammer cannot have it: was the tool dropped?")
        X_hand_ee = inverse(told[-1][1]) @ told[-1][0].X_camera_ee
        covariance = np.eye(6) * _SIGMA**2
        return InHandEstimate(
            Category.HAMMER_HEAD, X_hand_ee, covariance, 1.0, len(told), len(estimates_per_frame), True, "ok"
        )
