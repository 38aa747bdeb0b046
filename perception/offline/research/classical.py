"""Classical estimators of a held tool's pose, for comparison: the same detections and clouds, no pose network."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from scipy.spatial import KDTree

from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.perception.cloud import EeCloud, ee_cloud
from toolee_robot.types import Detection, RgbdFrame

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


def pose_of(estimator: Pose, frame: RgbdFrame, detection: Detection, X_camera_nominal: Array) -> Array | None:
    """Estimate the pose of a detected end effector.

    Args:
        estimator: The estimator.
        frame: The frame in which it was detected.
        detection: The detection.
        X_camera_nominal: Its pose in the nominal grasp, (4, 4): the hand's prior.

    Returns:
        X_camera_ee, (4, 4); None where too little of it has a depth.
    """
    cloud = ee_cloud(frame, detection)
    return estimator(cloud, X_camera_nominal) if cloud.usable else None


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
