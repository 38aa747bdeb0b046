"""The UR controller on the network: the probe's report against the station file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.arm_data import CB3_RATE
from toolee_robot.config import StationConfig
from toolee_robot.control import RobotModel
from toolee_robot.findings import Finding
from toolee_robot.hardware.ur.checks import UrExpected, check
from toolee_robot.hardware.ur.kinematics import calibration_of
from toolee_robot.hardware.ur.probe import nominal_rate, probe
from toolee_robot.types import DhCalibration


@dataclass(frozen=True)
class RobotCheck:
    """serial: the robot's, None where it does not tell. rate: of its servo loop [Hz]. calibration: the arm's own
    kinematics, ready for the station file, None where the controller does not tell them."""

    findings: list[Finding]
    serial: str | None
    rate: float
    calibration: DhCalibration | None


def expected_robot(config: StationConfig) -> UrExpected:
    """What a station file says of its robot: the bare hand as payload, the TCP at the flange."""
    model = RobotModel.of_station(config).description
    return UrExpected(
        model=config.arm.model,
        calibration=config.arm.calibration,
        payload=model.hand_payload(model.hand_open),
        tcp=np.zeros(6),
    )


def examine_robot(host: str, config: StationConfig) -> RobotCheck:
    """Ask the robot; its serial number is compared with the calibration's elsewhere."""
    report = probe(host)
    own = None if report.kinematics is None else calibration_of(report.kinematics.dh, config.arm.model)
    rate = CB3_RATE if report.version is None else nominal_rate(report.version)
    return RobotCheck(check(report, expected_robot(config)), report.serial, rate, own)
