"""Data sheets of the arms: the table that planner, driver, doctor, simulation and controller stand-in share.

Sources: Universal Robots, "DH parameters for calculations of kinematics and dynamics"; the UR10's and the UR10e's
technical data.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians

from toolee_robot.types import ArmModel, Six

CB3_RATE = 125.0
"""Rate of a CB3 controller's real-time data and of its servoj [Hz]."""
JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
"""Universal Robots' names of the joints, which people count from 1."""
E_SERIES_RATE = 500.0
"""Rate of an e-Series controller's real-time data and of its servoj [Hz]."""


@dataclass(frozen=True)
class ArmData:
    """Nominal data of one arm model; every tuple has one value per joint, base to wrist 3.

    Attributes:
        d: Denavit-Hartenberg offsets along z [m], standard (distal) convention.
        a: Denavit-Hartenberg lengths along x [m].
        alpha: Denavit-Hartenberg twists about x [rad].
        velocity: Largest joint speeds [rad/s].
        torque: Largest joint torques [Nm].
        payload: Largest mass at the flange [kg].
        rate: Rate of the controller's real-time data and of servoj [Hz].
        wrench_drift: Change of the error of the reported wrench from posture to posture, standard deviation per axis:
            force [N] and torque [Nm]. Assumed: docs/reference/ur_controller.md.
        link_mass: Masses of the links that the joints move [kg].
        link_center_of_mass: Their centres of mass [m], each in the link's Denavit-Hartenberg frame.
    """

    d: Six
    a: Six
    payload: float
    rate: float
    wrench_drift: tuple[float, float]
    link_mass: Six
    alpha: Six = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)
    velocity: Six = (radians(120), radians(120), radians(180), radians(180), radians(180), radians(180))
    torque: Six = (330.0, 330.0, 150.0, 56.0, 56.0, 56.0)
    link_center_of_mass: tuple[tuple[float, float, float], ...] = (
        (0.021, 0.0, 0.027),
        (0.38, 0.0, 0.158),
        (0.24, 0.0, 0.068),
        (0.0, 0.007, 0.018),
        (0.0, 0.007, 0.018),
        (0.0, 0.0, -0.026),
    )


ARM_DATA = {
    ArmModel.UR10: ArmData(
        d=(0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922),
        a=(0.0, -0.612, -0.5723, 0.0, 0.0, 0.0),
        payload=10.0,
        rate=CB3_RATE,
        wrench_drift=(2.1, 0.42),
        link_mass=(7.1, 12.7, 4.27, 2.0, 2.0, 0.365),
    ),
    ArmModel.UR10E: ArmData(
        d=(0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655),
        a=(0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0),
        payload=12.5,
        rate=E_SERIES_RATE,
        wrench_drift=(1.1, 0.07),
        link_mass=(7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
    ),
}
