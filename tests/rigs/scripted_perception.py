"""Perception from the ground truth, with scripted errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, transform
from toolee_robot.sim_backend.truth import PerfectPerception, Truth
from toolee_robot.types import CameraError, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

Change = Callable[[InHandEstimate], InHandEstimate]


class ScriptedPerception(PerfectPerception):
    """Perfect perception whose fused estimates are changed.

    Attributes:
        changes: The changes that remain.
        hands: Pose of the hand in the camera frame at the last frame of each look, (4, 4).
        sees: Whether anything is detected.
    """

    def __init__(self, judge: Truth, *changes: Change) -> None:
        super().__init__(judge)
        self.changes = list(changes) or [right]
        self.hands: list[Array] = []
        self.sees = True

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        return super().estimate(frame, hand, categories) if self.sees else []

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,
    ) -> InHandEstimate:
        self.hands.append(Xs_camera_hand[-1])
        change = self.changes.pop(0) if len(self.changes) > 1 else self.changes[0]
        return change(super().fuse(estimates_per_frame, Xs_camera_hand, category, camera))


def right(estimate: InHandEstimate) -> InHandEstimate:
    """Leave the estimate unchanged."""
    return estimate


def unsure(estimate: InHandEstimate) -> InHandEstimate:
    """Make the estimate unusable."""
    return replace(estimate, usable=False, reason="sigma 31 mm")


def moved(p: Sequence[float]) -> Change:
    """Displace the estimate by p, (3,) [m], along the face's own axes."""
    return lambda e: replace(e, X_hand_ee=e.X_hand_ee @ transform(p=p))
