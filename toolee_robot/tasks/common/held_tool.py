"""Where the held tool is looked for, and what is known of it. It flows through a job: `held = look(held, 3)`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.station import StationConfig
from toolee_robot.types import HeldRegion, InHandEstimate, Payload, RgbdFrame

POSE_ERRORS = 3.0
"""The hand's pose in the camera's frame is taken to be within so many times the calibration's residual, its root mean
square error across the line of sight on held-out poses of the arm: a Gaussian error is in all but 1 of 8,000 frames."""


def held_region(config: StationConfig, X_hand_ee: Array, displacement: float) -> HeldRegion:
    """The part of space, fixed to the hand, that holds the tool from its head to the hand.

    The hull of the head's axis and the hand's origin, widened by the tool's thickness, by how far the end effector may
    be from its nominal place in the hand, and by how far the hand may be from where kinematics and calibration have it.

    Args:
        config: The station, with the tool's envelope and the residual of the camera's calibration.
        X_hand_ee: Nominal pose of the end effector in the hand, (4, 4).
        displacement: Largest distance of the end effector from its nominal place in the hand [m].

    Returns:
        The region.
    """
    envelope = config.tool_envelope
    head = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -envelope.head_length]])
    thickness = max(envelope.head_radius, envelope.handle_radius)
    residual = 0.0 if config.calibration is None else config.calibration.residual
    points = np.vstack([transform_points(X_hand_ee, head), np.zeros(3)])
    return HeldRegion(points, thickness + displacement + POSE_ERRORS * residual)


@dataclass(frozen=True, eq=False)
class HeldTool:
    """The tool in the hand, as far as is known.

    Attributes:
        X_hand_ee: Estimated pose of the end effector in the hand, (4, 4).
        X_nominal: Where a look expects it: its pose in the hand in the nominal grasp, (4, 4).
        payload: Mass of the tool [kg] and its centre of mass in the end effector's frame [m].
        off: How far the end effector may be from there beside what any grasp leaves open [m]; 0 for a measured tool.
        weighed: Whether the arm has weighed the tool: the centre of mass is then known from the hand.
        seen: The last look, with its covariance; None before the first one, and where it no longer holds.
        frames: What the camera took at that look.
        strikes: Number of strikes since then.
        steady: Whether the tool has hardly slipped between the last two looks.
        turn: How a strike turns the face's normal, by these looks: a rotation vector in the face's axes, (3,) [rad].
    """

    X_hand_ee: Array
    X_nominal: Array
    payload: Payload
    off: float = 0.0
    weighed: bool = False
    seen: InHandEstimate | None = None
    frames: tuple[RgbdFrame, ...] = ()
    strikes: int = 0
    steady: bool = False
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def nominally(cls, X_hand_ee: Array, payload: Payload, off: float = 0.0) -> Self:
        """A tool that nobody has looked at yet.

        Args:
            X_hand_ee: Pose of the end effector in the hand in the nominal grasp, (4, 4).
            payload: Mass of the tool [kg] and its centre of mass in the end effector's frame [m].
            off: See the class.

        Returns:
            The tool.
        """
        return cls(X_hand_ee, X_hand_ee, payload, off)

    def moved(self, X_hand_ee: Array) -> HeldTool:
        """The tool with its end effector elsewhere in the hand, (4, 4)."""
        payload = self.payload.seen_from(inverse(X_hand_ee) @ self.X_hand_ee) if self.weighed else self.payload
        return replace(self, X_hand_ee=X_hand_ee, payload=payload)

    def shifted(self, distance: float) -> HeldTool:
        """The tool with its end effector farther along its own z by a distance [m]."""
        return self.moved(self.X_hand_ee @ transform(p=[0.0, 0.0, distance]))

    def struck(self) -> HeldTool:
        """The tool with one more strike done."""
        return replace(self, strikes=self.strikes + 1)

    def turned(self) -> HeldTool:
        """The tool as one more strike turns it in the hand."""
        return self.moved(self.X_hand_ee @ transform(Rotation.from_rotvec(self.turn)))

    def forgotten(self) -> HeldTool:
        """The tool where what was seen of it no longer holds, for instance after a stop: the next look is believed."""
        return replace(self, seen=None)
