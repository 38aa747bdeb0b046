"""toolee_robot: a robot-control stack for real hammering, after the paper ToolEENet."""

__version__ = "0.1.0"
