"""Planning of a swing as an optimal-control problem: harder strikes, and a command that turns back at the contact."""

from toolee_robot.control.planning.swing.contact import Face, SwingLimits
from toolee_robot.control.planning.swing.plan import plan_swing

__all__ = ["Face", "SwingLimits", "plan_swing"]
