"""Nominal grasp of a tool in a hand."""

from __future__ import annotations

from toolee_robot.config import StationConfig
from toolee_robot.end_effectors import Category
from toolee_robot.robots import hand_model
from toolee_robot.tasks.hammering.task import Grasp
from toolee_robot.tools import Tool


def nominal_grasp(tool: Tool, config: StationConfig) -> Grasp:
    """Compute the nominal grasp of a hammer from its data sheet; its true pose in the hand is unknown.

    Args:
        tool: A hammer.
        config: The station; only its hand is used.

    Returns:
        Pose of the tool in the hand, pose of its striking face, and mass properties.
    """
    X_hand_tool = hand_model(config.hand.model).grasp.X_hand_tool(tool.handle.grip_radius)
    return Grasp(X_hand_tool, tool.ee(Category.HAMMER_HEAD).X_tool_ee, tool.mass, tool.center_of_mass)
