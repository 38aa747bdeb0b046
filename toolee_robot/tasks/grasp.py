"""How a tool lies in the hand in a perfect handover."""

from __future__ import annotations

import numpy as np

from toolee_robot.robots import nominal_X_hand_tool
from toolee_robot.tasks.hammering import Grasp
from toolee_robot.tools import Tool
from toolee_robot.types import Category


def nominal_grasp(tool: Tool) -> Grasp:
    """How the tool lies in the hand nominally, from its data sheet: its true pose in the hand is not known."""
    radius = float(np.mean(tool.handle.radii_at(0.0)))
    X_tool_ee = tool.ee(Category.HAMMER_HEAD).X_tool_ee
    return Grasp(nominal_X_hand_tool(radius), X_tool_ee, tool.mass, tool.center_of_mass)
