"""Checks of a UR controller on the network: against the station file, and its force at rest against that of a touch."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from toolee_robot.arm_data import CB3_RATE
from toolee_robot.control import RobotModel
from toolee_robot.control.motion.touch_force import touch_settings
from toolee_robot.devices.ur.checks import UrExpected, check
from toolee_robot.devices.ur.probe import nominal_rate, probe
from toolee_robot.devices.ur.protocols.rtde import RtdeReader
from toolee_robot.devices.ur.setup_checks import calibration_of
from toolee_robot.doctor.frames import JOGGED_POINT, check_frames, check_mounting
from toolee_robot.errors import DeviceError, ProtocolError
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.frames import Array
from toolee_robot.station import StationConfig
from toolee_robot.types import DhCalibration

DURATION, PATIENCE = 1.0, 2.0
"""Duration of the measurement, and time for connecting on top [s]."""
OFFSET = 15.0
"""Offset at rest above which the payload is suspected, or a contact [N]. A CB3's estimate was seen to be 7 N off."""
FEW = 50
"""Readings below which nothing is concluded."""


@dataclass(frozen=True)
class ForceAtRest:
    """The force reading of an arm at rest.

    Attributes:
        mean: Mean of the magnitude |F| of the readings [N].
        sd: Standard deviation of that magnitude [N].
        offset: Magnitude of the mean force, which zeroing takes away [N].
        forces: The readings, (N, 3) [N].
        rate: Their rate [Hz].
    """

    mean: float
    sd: float
    offset: float
    forces: Array
    rate: float


def measure_force(host: str, rate: float) -> ForceAtRest:
    """Read the force for a second; connects as a reader and moves nothing.

    Args:
        host: Address of the controller.
        rate: Its rate [Hz].

    Returns:
        What the force is at rest.

    Raises:
        DeviceError: The robot does not answer, or too few readings came.
        ProtocolError: The controller tells no force.
    """
    deadline = time.monotonic() + PATIENCE + DURATION
    with RtdeReader.connect(host, deadline) as reader:
        if reader.subscribe(["actual_TCP_force"], rate, deadline):
            raise ProtocolError("the controller tells no actual_TCP_force")
        end = time.monotonic() + DURATION
        readings = []
        while time.monotonic() < end:
            readings.append(reader.read(deadline).values["actual_TCP_force"])
    forces = np.array(readings, dtype=np.float64)
    if len(forces) < FEW or forces.ndim != 2 or not np.all(np.isfinite(forces)):
        raise DeviceError(f"{len(forces)} readings of the force came, or not finite ones")
    return force_at_rest(forces[:, :3], rate)


def force_at_rest(forces: Array, rate: float) -> ForceAtRest:
    """Evaluate readings of the force at rest.

    Args:
        forces: The readings, (N, 3) [N].
        rate: Their rate [Hz].

    Returns:
        Mean, deviation and offset.
    """
    magnitude = np.linalg.norm(forces, axis=1)
    offset = float(np.linalg.norm(np.mean(forces, axis=0)))
    return ForceAtRest(float(np.mean(magnitude)), float(np.std(magnitude)), offset, forces, rate)


def check_force(force: ForceAtRest, config: StationConfig) -> Finding:
    """Compare the force at rest with the force that ends a touch.

    Args:
        force: The force at rest.
        config: Configuration of the station.

    Returns:
        The finding.
    """
    name, strike = "force", config.strike
    message = f"at rest |F| is {force.mean:.1f} N, sd {force.sd:.1f} N; offset {force.offset:.1f} N"
    if force.offset > OFFSET:
        return fail(name, message, "correct the payload, or remove what the arm leans against")
    try:
        touch = touch_settings(force.forces, force.rate, strike)
    except DeviceError as error:
        return warn(name, message, str(error))
    message += f"; a touch goes at {1e3 * touch.speed:.0f} mm/s and ends at {touch.force:.1f} N"
    return ok(name, message if force.sd > 1e-6 else f"{message}; no noise, as only a simulation's")


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
