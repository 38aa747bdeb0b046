"""ToolEENet's estimator, the reference: PointNet++, variance-exploding score matching, RK45, mean pooling.

As in the paper and its published code: un-centred clouds, but the pose's translation from their mean; no augmentation,
no direction to the rest of the tool, the symmetry label a constant of the class, no confidence. Two faults are not
reproduced: the step size of the RK45 solver is per cloud (theirs is shared by the whole batch), and no metric ignores
axes because the prediction says so (`toolee_robot.perception.offline.evaluation` has that rule as an extra column).
"""

from toolee_robot.perception.pose.tooleenet.estimator import COLUMNS, Column, PaperEstimator

__all__ = ["COLUMNS", "Column", "PaperEstimator"]
