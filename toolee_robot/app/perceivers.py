"""What a job perceives with: the networks, the simulation's ground truth, or what is compared with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolee_robot.app.sources import Opened
from toolee_robot.app.variant import Variant
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.look import Perceiver
from toolee_robot.types import CameraError, Detection, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

if TYPE_CHECKING:
    from toolee_robot.perception import ToolPerception

SURFACE = 20_000
"""Number of points on the tool's surface that a registration uses."""
BELIEVES_NOMINAL = (Variant.POSITION_ONLY, Variant.NORMAL_ONLY, Variant.MASK_CENTROID)
"""Variants that take the face's nominal place or direction for the true one, or begin with it."""
PoseOf = Callable[[RgbdFrame, Detection, Array], Array | None]
"""Estimates X_camera_ee, (4, 4), of a detection in a frame, from its nominal one; None where it cannot."""


class AlteredPoses:
    """A perceiver that does what another one does, but for poses that are estimated otherwise, or partly believed.

    Which estimates are usable, and their weights in the fusion, stay those of the other one.

    Args:
        perceiver: The other one.
        X_hand_ee: Pose of the end effector in the hand in the nominal grasp, (4, 4).
        pose_of: Estimates the pose of a detection; None for the other one's.
        position: Whether the fused position is kept; else it is the nominal one.
        orientation: Whether the fused orientation is kept; else it is the nominal one.
    """

    def __init__(
        self,
        perceiver: Perceiver,
        X_hand_ee: Array,
        pose_of: PoseOf | None = None,
        *,
        position: bool = True,
        orientation: bool = True,
    ) -> None:
        self._perceiver, self._nominal, self._pose_of = perceiver, X_hand_ee, pose_of
        self._position, self._orientation = position, orientation

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        """See `Perceiver`; the hand is given, as a task does."""
        estimates = self._perceiver.estimate(frame, hand, categories)
        if self._pose_of is None:
            return estimates
        assert hand is not None, "the task has to say where the hand is"
        nominal = hand.X_camera_hand @ self._nominal
        poses = [self._pose_of(frame, estimate.detection, nominal) for estimate in estimates]
        return [
            estimate if X is None or not np.isfinite(estimate.X_camera_ee).all() else replace(estimate, X_camera_ee=X)
            for estimate, X in zip(estimates, poses, strict=True)
        ]

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,
    ) -> InHandEstimate:
        """See `Perceiver`; what is not kept is the believed pose's."""
        fused = self._perceiver.fuse(estimates_per_frame, Xs_camera_hand, category, camera)
        place = fused.X_hand_ee if self._position else self._nominal
        turn = fused.X_hand_ee if self._orientation else self._nominal
        return replace(fused, X_hand_ee=transform(turn[:3, :3], place[:3, 3]))


def job_networks(paper_weights: Path | None = None, device: str = "cpu") -> ToolPerception:
    """Load the networks of a job.

    Args:
        paper_weights: Folder of a training of the paper's estimator, which takes the pose network's place; None: what
            ships.
        device: torch device that runs them.

    Returns:
        The networks. The paper's estimator gets no trust model: none was fitted for it, and it has no confidence.

    Raises:
        AssetError: Weights are missing or unreadable.
        UserError: The weights are for clouds of whole tools; code `user.paper_column`.
    """
    from toolee_robot.perception import ToolPerception  # here: a job without networks begins in half the time

    if paper_weights is None:
        return ToolPerception.load(device=device)
    from toolee_robot.perception.detection.segmenter import Segmenter
    from toolee_robot.perception.pose.tooleenet import PaperEstimator

    return ToolPerception(Segmenter.load(device=device), PaperEstimator.load_for_job(paper_weights, device))


def job_perceiver(variant: Variant, networks: Perceiver | None, opened: Opened) -> tuple[Perceiver, StationConfig]:
    """Build the perception of a job.

    Args:
        variant: What it leaves out or does instead.
        networks: The whole perception; for `PAPER` with the paper's estimator, for `PERFECT_PERCEPTION` None.
        opened: The station.

    Returns:
        The perception, and the configuration of the job.

    Raises:
        UserError: The variant needs what only a simulation knows, or believes a part of the face's
            nominal pose, of a tool whose face nobody has measured (`user.unknown_face`).
    """
    config, nominal = opened.config, opened.grasp.X_hand_ee
    if opened.grasp.ee_off and variant in BELIEVES_NOMINAL:
        raise UserError(
            f"--variant {variant} needs the tool's face. Give tool.face and tool.face_normal, or leave the option out",
            code="user.unknown_face",
        )
    if networks is None:
        return _true_poses(opened), config
    if variant is Variant.ONE_VIEW:
        return networks, replace(config, task=replace(config.task, views=1, views_again=1))
    if variant in (Variant.POSITION_ONLY, Variant.NORMAL_ONLY):
        position = variant is Variant.POSITION_ONLY
        return AlteredPoses(networks, nominal, position=position, orientation=not position), config
    if variant in (Variant.MASK_CENTROID, Variant.ICP):
        from toolee_robot.perception.offline.research import classical

        centroid = variant is Variant.MASK_CENTROID
        pose = classical.centroid_pose if centroid else classical.registration(_surface(opened))
        return AlteredPoses(networks, nominal, partial(classical.pose_of, pose)), config
    return networks, config


def _true_poses(opened: Opened) -> Perceiver:
    if opened.truth is None:
        raise UserError(
            f"--variant {Variant.PERFECT_PERCEPTION} needs the tool's true pose, which only a simulation knows"
        )
    from toolee_robot.sim_backend.truth import PerfectPerception  # a real station loads none

    return PerfectPerception(opened.truth)


def _surface(opened: Opened) -> Array:
    """Points on the tool's surface in the frame of its striking face, (S, 3) [m]."""
    if opened.shape is None:
        raise UserError(f"--variant {Variant.ICP} needs the tool's shape, which only a simulation knows")
    points = opened.shape.mesh.sample(SURFACE, seed=0)
    return transform_points(inverse(opened.shape.ee(Category.HAMMER_HEAD).X_tool_ee), points)
