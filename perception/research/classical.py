"""Classical estimators of a held tool's pose, for comparison: the same detections and clouds, no pose network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
import trimesh
from scipy.spatial import KDTree

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.perception.cloud import EeCloud, ee_cloud
from toolee_robot.types import HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

FRONT = 0.95
"""Quantile of the visible points along the face's normal that is taken for the face's plane; the rest is noise."""
ICP_STEPS, ICP_CHANGE = 150, 1e-11
"""Most iterations of a round, and the change of its cost at which it ends [m^2]: a shape slides slowly along its
handle."""
KEPT, ROUNDS = 0.8, 6
"""Share of the points, the nearest ones, that count from the second of the registration's rounds on: mask and depth
have outliers."""

Pose = Callable[[EeCloud, Array], Array]
"""Estimates X_camera_ee, (4, 4), from the clouds of a detection and the nominal X_camera_ee."""


class Perceives(Protocol):
    """The perception whose detections are kept; `ToolPerception`."""

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        """See `ToolPerception.estimate`."""

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
    ) -> InHandEstimate:
        """See `ToolPerception.fuse`."""


class ClassicalPoses:
    """Perception that sees what the whole one sees, and estimates each pose in another way.

    Which estimates are usable, and their weights in the fusion, stay those of the whole perception.

    Args:
        perception: The whole perception.
        X_hand_ee: Pose of the end effector in the hand in the nominal grasp, (4, 4): the hand's prior.
        pose: The estimator.
    """

    def __init__(self, perception: Perceives, X_hand_ee: Array, pose: Pose) -> None:
        self._perception, self._nominal, self._pose = perception, X_hand_ee, pose

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        """See `ToolPerception.estimate`; the hand's pose must be given.

        Args:
            frame: The frame.
            hand: The hand that holds the tool.
            categories: The categories wanted.

        Returns:
            One estimate per detection, in the camera frame.

        Raises:
            UserError: The hand's pose is not given (code `user.no_hand`), or the frame is unusable.
        """
        if hand is None:
            raise UserError("a classical pose begins with the hand's: give it", code="user.no_hand")
        nominal = hand.X_camera_hand @ self._nominal
        estimates = []
        for estimate in self._perception.estimate(frame, hand, categories):
            cloud = ee_cloud(frame, estimate.detection)
            posed = cloud.usable and bool(np.isfinite(estimate.X_camera_ee).all())
            estimates.append(replace(estimate, X_camera_ee=self._pose(cloud, nominal)) if posed else estimate)
        return estimates

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
    ) -> InHandEstimate:
        """See `ToolPerception.fuse`.

        Args:
            estimates_per_frame: The estimates of each frame.
            Xs_camera_hand: Pose of the hand in the camera frame at each frame, (4, 4).
            category: The end effector wanted; None: the one with the largest summed confidence.

        Returns:
            The fused pose in the hand.

        Raises:
            PerceptionError: No frame has a pose of the end effector.
        """
        return self._perception.fuse(estimates_per_frame, Xs_camera_hand, category)


def centroid_pose(cloud: EeCloud, X_camera_nominal: Array) -> Array:
    """The nominal orientation, where the mask's points are: their centroid, at the foremost of them.

    Args:
        cloud: The clouds of the detection.
        X_camera_nominal: Pose of the end effector in the nominal grasp, (4, 4), its z axis out of the face.

    Returns:
        X_camera_ee, (4, 4).
    """
    normal, centroid = X_camera_nominal[:3, 2], cloud.points.mean(axis=0)
    front = float(np.quantile(cloud.points @ normal, FRONT))
    return transform(X_camera_nominal[:3, :3], centroid + (front - float(centroid @ normal)) * normal)


def registration(surface: Array) -> Pose:
    """The iterative closest point method (Besl and McKay 1992, trimmed as by Chetverikov 2002) on the tool's own shape.

    It begins at `centroid_pose` and uses all visible points of the tool.

    Args:
        surface: Points on the tool's surface, dense, in the frame of its end effector, (S, 3) [m].

    Returns:
        The estimator.
    """
    tree = KDTree(surface)

    def pose(cloud: EeCloud, X_camera_nominal: Array) -> Array:
        points = np.concatenate([cloud.points, cloud.rest])
        X_ee_camera = inverse(centroid_pose(cloud, X_camera_nominal))
        kept = points
        for _ in range(ROUNDS):
            X_ee_camera, *_ = trimesh.registration.icp(  # type: ignore[no-untyped-call]
                kept, surface, X_ee_camera, ICP_CHANGE, ICP_STEPS, reflection=False, scale=False
            )
            off = tree.query(transform_points(X_ee_camera, points))[0]
            kept = points[off <= np.quantile(off, KEPT)]
        return inverse(X_ee_camera)

    return pose
