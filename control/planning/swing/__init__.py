"""Planning of a swing as an optimal-control problem: harder strikes, and a command that turns back at the contact."""

from toolee_robot.control.planning.swing.plan import plan_swing
from toolee_robot.control.planning.swing.problem import Face, SwingLimits

__all__ = ["Face", "SwingLimits", "plan_swing"]
