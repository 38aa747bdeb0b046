"""Nominal grasp of a tool in a hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, frame_from_axes, inverse
from toolee_robot.robots import hand_model
from toolee_robot.station import StationConfig, ToolData
from toolee_robot.tools import Tool
from toolee_robot.types import Payload

UNKNOWN_GRIP = 0.016
"""Radius of a handle of which nothing is known [m], good to some 4 mm: the hand's grasp is no better known."""
UNKNOWN_FACE = frame_from_axes(z=np.array([1.0, 0.0, 0.0]), x=np.array([0.0, 0.0, -1.0]), p=[0.05, 0.0, 0.22])
"""Where a face of which nothing is known is looked for first: its pose in the tool, (4, 4)."""
UNKNOWN_FACE_OFF = 0.08
"""How far from there it may be [m], beside what any grasp leaves open: hammers of one hand have it 0.15 to 0.28 m from
the grip's middle."""
UNKNOWN_MASS, UNKNOWN_CENTER = 1.5, np.array([0.0, 0.0, 0.18])
"""Mass [kg] and centre of mass in the tool [m] of a tool that was not weighed yet: more than those of any hammer that
one hand swings, for what is planned before."""


@dataclass(frozen=True)
class Grasp:
    """Nominal grasp of a tool, from its data sheet; the true pose in the hand is unknown.

    Attributes:
        X_hand_tool: Pose of the tool in the hand, (4, 4).
        X_tool_ee: Pose of the end effector in the tool, (4, 4).
        mass: Mass of the tool [kg].
        p_tool_com: Centre of mass of the tool, tool frame, (3,) [m].
        to_weigh: Whether mass and centre of mass are those of no tool, and the arm weighs it.
        ee_off: How far the end effector may be from `X_tool_ee` [m]; 0 where it was measured.
    """

    X_hand_tool: Array
    X_tool_ee: Array
    mass: float
    p_tool_com: Array
    to_weigh: bool = False
    ee_off: float = 0.0

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
        Pose of the tool in the hand, pose of its striking face, and mass properties; bounds for what is not measured.
    """
    radius = UNKNOWN_GRIP if tool.grip_radius is None else tool.grip_radius
    X_hand_tool = hand_model(config.hand).grasp.X_hand_tool(radius)
    X_tool_face, off = tool.X_tool_face, 0.0
    if X_tool_face is None:
        X_tool_face, off = UNKNOWN_FACE, UNKNOWN_FACE_OFF
    if tool.mass is None or tool.center_of_mass is None:
        return Grasp(X_hand_tool, X_tool_face, UNKNOWN_MASS, UNKNOWN_CENTER, to_weigh=True, ee_off=off)
    return Grasp(X_hand_tool, X_tool_face, tool.mass, np.asarray(tool.center_of_mass), ee_off=off)


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
