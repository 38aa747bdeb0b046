"""Checks of a station before the first motion. Each finding states its remedy; nothing is moved."""

from toolee_robot.doctor.configuration import check_calibration, check_limits
from toolee_robot.doctor.devices import check_arm, check_camera, check_hand, check_person
from toolee_robot.doctor.machine import check_disk, check_processor, check_real_time
from toolee_robot.doctor.reach import check_reach
from toolee_robot.doctor.robot import RobotCheck, examine_robot
from toolee_robot.doctor.weights import check_weights

__all__ = [
    "RobotCheck",
    "check_arm",
    "check_calibration",
    "check_camera",
    "check_disk",
    "check_hand",
    "check_limits",
    "check_person",
    "check_processor",
    "check_reach",
    "check_real_time",
    "check_weights",
    "examine_robot",
]
