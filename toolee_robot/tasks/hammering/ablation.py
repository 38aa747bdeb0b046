"""Jobs that perceive less than the whole system, or in another way, to see what each part is worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import StrEnum

import numpy as np

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, transform
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.look import Perceiver
from toolee_robot.tasks.hammering.learnt_grasp import LearntShift
from toolee_robot.types import CameraError, Detection, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate


class Ablation(StrEnum):
    """What a job leaves out, or does instead."""

    POSITION_ONLY = "position_only"
    """The estimated orientation: the nominal one is believed."""
    NORMAL_ONLY = "normal_only"
    """The estimated position: the nominal one is believed."""
    ONE_VIEW = "one_view"
    """All views of a look but the first."""
    MASK_CENTROID = "mask_centroid"
    """The pose network: the face is at the mask's centroid, with the nominal orientation."""
    ICP = "icp"
    """The pose network: the tool's own shape is registered to the cloud (iterative closest point)."""
    PAPER = "paper"
    """The pose network: the paper's estimator takes its place."""
    LEARNT_GRASP = "learnt_grasp"
    """The estimated pose: the nominal one is believed, moved as closing fingers moved earlier tools in the mean."""


PoseOf = Callable[[RgbdFrame, Detection, Array], Array | None]
"""Estimates X_camera_ee, (4, 4), of a detection in a frame, from its nominal one; None where it cannot."""


class Wrapped:
    """A perceiver that does what another one does.

    Args:
        perceiver: The other one.
        X_hand_ee: Pose of the end effector in the hand in the nominal grasp, (4, 4).
    """

    def __init__(self, perceiver: Perceiver, X_hand_ee: Array) -> None:
        self._perceiver, self._nominal = perceiver, X_hand_ee

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        """See `Perceiver`."""
        return self._perceiver.estimate(frame, hand, categories)

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,
    ) -> InHandEstimate:
        """See `Perceiver`."""
        return self._perceiver.fuse(estimates_per_frame, Xs_camera_hand, category, camera)


class PartlyNominal(Wrapped):
    """A perceiver whose fused pose is in part, or wholly, one that was believed before it looked.

    Args:
        perceiver: The whole perception.
        X_hand_ee: The believed pose of the end effector in the hand, (4, 4).
        position: Whether the estimated position is kept.
        orientation: Whether the estimated orientation is kept.
    """

    def __init__(self, perceiver: Perceiver, X_hand_ee: Array, *, position: bool, orientation: bool) -> None:
        super().__init__(perceiver, X_hand_ee)
        self._position, self._orientation = position, orientation

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,
    ) -> InHandEstimate:
        """See `Perceiver`; what is not kept is the believed pose's."""
        fused = super().fuse(estimates_per_frame, Xs_camera_hand, category, camera)
        place = fused.X_hand_ee if self._position else self._nominal
        turn = fused.X_hand_ee if self._orientation else self._nominal
        return replace(fused, X_hand_ee=transform(turn[:3, :3], place[:3, 3]))


class OtherPoses(Wrapped):
    """A perceiver that detects what another one does, and estimates each pose in another way.

    Which estimates are usable, and their weights in the fusion, stay those of the other one.

    Args:
        perceiver: The whole perception.
        X_hand_ee: Pose of the end effector in the hand in the nominal grasp, (4, 4).
        pose_of: Estimates a pose.
    """

    def __init__(self, perceiver: Perceiver, X_hand_ee: Array, pose_of: PoseOf) -> None:
        super().__init__(perceiver, X_hand_ee)
        self._pose_of = pose_of

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        """See `Perceiver`; the hand is given, as a task does."""
        assert hand is not None, "a task tells where the hand is"
        nominal = hand.X_camera_hand @ self._nominal
        estimates = super().estimate(frame, hand, categories)
        poses = [self._pose_of(frame, estimate.detection, nominal) for estimate in estimates]
        return [
            estimate if X is None or not np.isfinite(estimate.X_camera_ee).all() else replace(estimate, X_camera_ee=X)
            for estimate, X in zip(estimates, poses, strict=True)
        ]


def ablated(
    ablation: Ablation | None,
    perceiver: Perceiver,
    config: StationConfig,
    X_hand_ee: Array,
    pose_of: PoseOf | None = None,
    shift: LearntShift | None = None,
) -> tuple[Perceiver, StationConfig]:
    """Leave out a part of perception, or replace it.

    Args:
        ablation: What; None for nothing.
        perceiver: The whole perception; for `PAPER` with the paper's estimator.
        config: Configuration of the station.
        X_hand_ee: Pose of the end effector in the hand in the nominal grasp, (4, 4).
        pose_of: What estimates poses instead of the network; for `MASK_CENTROID` and `ICP`.
        shift: How the hand moves tools as it closes; for `LEARNT_GRASP`.

    Returns:
        Perception and configuration of the job.
    """
    if ablation is Ablation.ONE_VIEW:
        return perceiver, replace(config, task=replace(config.task, views=1, views_again=1))
    if ablation in (Ablation.POSITION_ONLY, Ablation.NORMAL_ONLY):
        position = ablation is Ablation.POSITION_ONLY
        return PartlyNominal(perceiver, X_hand_ee, position=position, orientation=not position), config
    if shift is not None:
        return PartlyNominal(perceiver, shift.X_hand @ X_hand_ee, position=False, orientation=False), config
    return perceiver if pose_of is None else OtherPoses(perceiver, X_hand_ee, pose_of), config
