"""From the partial cloud of an end effector to its 6D pose.

    from toolee_robot.perception.pose import PoseEstimator
    result = PoseEstimator.load().estimate(points, category, rest)

Network, sampler, pooling, symmetry fix, confidence and fusion. Only numpy, scipy, torch and safetensors are needed
here, so that training runs on a bare GPU machine.
"""

from toolee_robot.perception.pose.cloud_estimator import CloudEstimator, PoseResult
from toolee_robot.perception.pose.estimator import PoseEstimator
from toolee_robot.perception.pose.fusion import UNKNOWN_CAMERA, fuse_in_hand

__all__ = ["UNKNOWN_CAMERA", "CloudEstimator", "PoseEstimator", "PoseResult", "fuse_in_hand"]
