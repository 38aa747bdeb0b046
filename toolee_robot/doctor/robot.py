"""Check of a UR controller on the network against the station file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.arm_data import CB3_RATE
from toolee_robot.control import RobotModel
from toolee_robot.devices.ur.checks import UrExpected, check
from toolee_robot.devices.ur.probe import nominal_rate, probe
from toolee_robot.devices.ur.setup_checks import calibration_of
from toolee_robot.doctor.force import check_force, measure_force
from toolee_robot.doctor.frames import JOGGED_POINT, check_frames
from toolee_robot.doctor.mounting import check_mounting
from toolee_robot.errors import DeviceError
from toolee_robot.findings import Finding
from toolee_robot.frames import Array
from toolee_robot.station import StationConfig
from toolee_robot.types import DhCalibration


@dataclass(frozen=True)
class RobotCheck:
    """Result of the check of a UR controller.

    Attributes:
        findings: The findings.
        serial: Serial number of the robot; None if unknown.
        rate: Rate of its servo loop [Hz].
        calibration: Factory calibration of the arm, in the form of the station file; None if unknown.
    """

    findings: list[Finding]
    serial: str | None
    rate: float
    calibration: DhCalibration | None

    @property
    def compares_points(self) -> bool:
        """Whether a reading at the pendant can be compared with the robot: it tells where it is."""
        return any(finding.name == JOGGED_POINT for finding in self.findings)


def expected_robot(config: StationConfig) -> UrExpected:
    """Derive the expected state of the robot from a station file: payload of the bare hand, TCP at the flange."""
    model = RobotModel.of_station(config).description
    return UrExpected(
        model=config.arm.model,
        calibration=config.arm.calibration,
        payload=model.hand_payload(model.hand_open),
        tcp=np.zeros(6),
    )


def examine_robot(host: str, config: StationConfig, jogged_point: Array | None = None) -> RobotCheck:
    """Probe the controller and compare it with the station file, except for the serial number.

    Args:
        host: Address of the controller.
        config: Configuration of the station.
        jogged_point: The TCP that the teach pendant shows now, feature Base, (3,) [m]; None if nobody has read it.

    Returns:
        The findings, and what the controller reports of itself.
    """
    report = probe(host)
    own = None if report.kinematics is None else calibration_of(report.kinematics.dh, config.arm.model)
    rate = CB3_RATE if report.version is None else nominal_rate(report.version)
    findings = check(report, expected_robot(config))
    if report.state is not None and report.quality is not None:
        findings += check_frames(report.state, config, jogged_point)
        findings.append(check_mounting(report.state, config))
        try:
            findings.append(check_force(measure_force(host, rate), config))
        except DeviceError as error:
            findings.append(Finding.of_error("force", error, "look for other RTDE clients and a bad network"))
    return RobotCheck(findings, report.serial, rate, own)
