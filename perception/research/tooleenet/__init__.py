"""ToolEENet's own estimator, the named reference: PointNet++, variance-exploding score matching, RK45, mean pooling.

As the paper and its published code have it: un-centred clouds, no augmentation, no direction to the rest of the tool,
the symmetry label a constant of the class, no confidence. Two faults are not kept: the step size of the RK45 solver is
each cloud's own (theirs is shared by the whole batch), and a metric never asks the prediction which axes to ignore
(`toolee_robot.perception.evaluation` has that rule as an extra column).
"""

from toolee_robot.perception.research.tooleenet.estimator import COLUMNS, Column, PaperEstimator, column_of
from toolee_robot.perception.research.tooleenet.recipe import PaperRecipe

__all__ = ["COLUMNS", "Column", "PaperEstimator", "PaperRecipe", "column_of"]
