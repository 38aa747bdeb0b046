"""From the partial cloud of an end effector to its 6D pose: network, sampler, pooling, symmetry fix, confidence,
fusion.

    from toolee_robot.perception.pose import PoseEstimator
    result = PoseEstimator.load().estimate(points, category, rest)

Only numpy, scipy, torch and safetensors are needed here, so that training runs on a bare GPU machine.
"""

from toolee_robot.perception.pose.cloud_estimator import CloudEstimator, PoseResult
from toolee_robot.perception.pose.estimator import PoseEstimator
from toolee_robot.perception.pose.fusion import fuse_in_hand

__all__ = ["CloudEstimator", "PoseEstimator", "PoseResult", "fuse_in_hand"]
