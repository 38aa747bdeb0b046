"""Nominal grasp of a tool in a hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.config import StationConfig, ToolData
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse
from toolee_robot.robots import hand_model
from toolee_robot.tools import Tool
from toolee_robot.types import Payload


@dataclass(frozen=True)
class Grasp:
    """Nominal grasp of a tool, from its data sheet; the true pose in the hand is unknown.

    Attributes:
        X_hand_tool: Pose of the tool in the hand, (4, 4).
        X_tool_ee: Pose of the end effector in the tool, (4, 4).
        mass: Mass of the tool [kg].
        p_tool_com: Centre of mass of the tool, tool frame, (3,) [m].
    """

    X_hand_tool: Array
    X_tool_ee: Array
    mass: float
    p_tool_com: Array

    @property
    def X_hand_ee(self) -> Array:
        """Nominal pose of the end effector in the hand, (4, 4)."""
        return self.X_hand_tool @ self.X_tool_ee

    @property
    def swung(self) -> Payload:
        """Mass of the tool [kg] and its centre of mass in the end effector's frame [m]."""
        return Payload(self.mass, self.p_tool_com).seen_from(inverse(self.X_tool_ee))


def measured_grasp(tool: ToolData, config: StationConfig) -> Grasp:
    """Compute the nominal grasp of a lab's hammer, as the station file tells it.

    Args:
        tool: The hammer: `config.tool`.
        config: The station; only its hand is used.

    Returns:
        Pose of the tool in the hand, pose of its striking face, and mass properties.
    """
    X_hand_tool = hand_model(config.hand).grasp.X_hand_tool(tool.grip_radius)
    return Grasp(X_hand_tool, tool.X_tool_face, tool.mass, np.asarray(tool.center_of_mass))


def nominal_grasp(tool: Tool, config: StationConfig) -> Grasp:
    """Compute the nominal grasp of a hammer from its data sheet; its true pose in the hand is unknown.

    Args:
        tool: A hammer.
        config: The station; only its hand is used.

    Returns:
        Pose of the tool in the hand, pose of its striking face, and mass properties.
    """
    X_hand_tool = hand_model(config.hand).grasp.X_hand_tool(tool.handle.grip_radius)
    return Grasp(X_hand_tool, tool.ee(Category.HAMMER_HEAD).X_tool_ee, tool.mass, tool.center_of_mass)
