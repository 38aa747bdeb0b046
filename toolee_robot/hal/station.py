"""The station: the devices that a task uses."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.hal.arm import Arm
from toolee_robot.hal.device import Clock, Hand, RgbdCamera
from toolee_robot.hal.person import Person


@dataclass(frozen=True)
class Station:
    """The devices that a task uses.

    Attributes:
        arm: The arm.
        hand: The hand on the arm's flange.
        camera: The fixed RGB-D camera.
        person: The person at the station.
        clock: Clock of every stamp in the station.
        robot_serial: Serial number that the robot reports; empty if it reports none.
        camera_serial: Serial number that the camera reports; empty if it reports none.
    """

    arm: Arm
    hand: Hand
    camera: RgbdCamera
    person: Person
    clock: Clock
    robot_serial: str = ""
    camera_serial: str = ""
