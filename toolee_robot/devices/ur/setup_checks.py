"""Checks of a robot's installation (payload, TCP) and of its arm's calibrated kinematics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.devices.ur.kinematics import angle_between, tcp_error, worst_error
from toolee_robot.devices.ur.report import UrReport, UrState
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.frames import Array
from toolee_robot.robots.dh import DhParameters
from toolee_robot.types import ArmModel, DhCalibration, Payload

MASS_TOLERANCE, COG_TOLERANCE = 0.1, 0.02  # [kg], [m]
TCP_TOLERANCE, TCP_ANGLE_TOLERANCE = 1e-3, np.deg2rad(0.5)  # [m], [rad]
KINEMATICS_TOLERANCE, NOMINAL_TOLERANCE = 1e-3, 0.02
"""[m] Agreement of two kinematics, and of an arm with its nominal model. UR10 and UR10e differ by 50 mm."""


@dataclass(frozen=True)
class UrExpected:
    """What the configuration requires of a robot; None for no check.

    Attributes:
        model: Arm model.
        calibration: Calibrated kinematics; None for the nominal ones.
        payload: Payload in the installation, in the flange frame.
        tcp: TCP in the installation, (6,): position [m], rotation vector [rad], flange frame.
        serial: Serial number.
    """

    model: ArmModel
    calibration: DhCalibration | None = None
    payload: Payload | None = None
    tcp: Array | None = None
    serial: str | None = None


def check_payload(state: UrState, expected: UrExpected) -> Finding:
    """Check mass and centre of gravity in the installation, read before any program sets its own.

    Args:
        state: The robot's state.
        expected: What the configuration requires.

    Returns:
        The finding.
    """
    name, is_, wanted = "payload", state.payload, expected.payload
    if is_ is None:
        return warn(name, "this PolyScope does not report it", "compare payload and centre of gravity on the pendant")
    message = _payload_text(is_)
    if wanted is None:
        return ok(name, message)
    off = float(np.linalg.norm(is_.center_of_mass - wanted.center_of_mass))
    # The centre of gravity of a negligible mass does not matter.
    if not (abs(is_.mass - wanted.mass) <= MASS_TOLERANCE and (off <= COG_TOLERANCE or wanted.mass <= MASS_TOLERANCE)):
        return fail(
            name,
            f"{message}, the configuration says {_payload_text(wanted)}",
            "set it in the installation's payload page",
        )
    return ok(name, message)


def _payload_text(payload: Payload) -> str:
    x, y, z = payload.center_of_mass * 1e3
    return f"{payload.mass:.2f} kg at ({x:.0f}, {y:.0f}, {z:.0f}) mm"


def check_tcp(state: UrState, expected: UrExpected) -> Finding:
    """Check the TCP in the flange frame.

    Args:
        state: The robot's state.
        expected: What the configuration requires.

    Returns:
        The finding.
    """
    tcp, wanted = state.tcp_offset, expected.tcp
    if tcp is None:
        return warn("TCP", "this PolyScope does not report its offset", "compare it on the teach pendant")
    if wanted is None:
        return ok("TCP", _tcp_text(tcp))
    apart, turned = float(np.linalg.norm(tcp[:3] - wanted[:3])), angle_between(tcp[3:], wanted[3:])
    if not (apart <= TCP_TOLERANCE and turned <= TCP_ANGLE_TOLERANCE):
        message = f"{_tcp_text(tcp)}, the configuration says {_tcp_text(wanted)}"
        return fail("TCP", message, "set it in the installation's TCP page")
    return ok("TCP", _tcp_text(tcp))


def check_kinematics(report: UrReport, state: UrState, expected: UrExpected) -> Finding:
    """Check the arm's kinematics: by the controller's parameters if it reports them, else by its TCP pose.

    Args:
        report: What a probe has read from the robot.
        state: The robot's state.
        expected: What the configuration requires.

    Returns:
        The finding.
    """
    name = "kinematics"

    def error(dh: DhParameters) -> float:
        if report.kinematics is not None:
            return worst_error(dh, report.kinematics.dh)
        tcp = next((t for t in (state.tcp_offset, expected.tcp) if t is not None), np.zeros(6))
        return tcp_error(dh, state.q, tcp, state.tcp_pose)

    calibrated = expected.calibration is not None
    off = error(DhParameters.of(expected.model, expected.calibration))
    where = "at most" if report.kinematics is not None else "in this posture"
    message = (
        f"the {'calibrated' if calibrated else 'nominal'} {expected.model} is {off * 1e3:.1f} mm off the arm {where}"
    )
    if off <= KINEMATICS_TOLERANCE:
        return ok(name, message)
    if off <= NOMINAL_TOLERANCE and not calibrated:
        return warn(name, message, "set arm.calibration to this arm's own: `toolee doctor --json` prints it")
    fits = {model: error(DhParameters.of(model)) for model in ArmModel}
    best = min(fits, key=lambda model: fits[model])
    if fits[best] <= NOMINAL_TOLERANCE and best is not expected.model:
        return fail(name, f"{message}; {best} fits to {fits[best] * 1e3:.1f} mm", "set arm.model in the station file")
    if calibrated:
        return fail(name, message, "arm.calibration is of another arm: `toolee doctor --json` prints this one's")
    return fail(name, message, "check model and TCP; a joint may have been replaced without a new calibration")


def _tcp_text(tcp: Array) -> str:
    x, y, z = tcp[:3] * 1e3
    turned = np.rad2deg(np.linalg.norm(tcp[3:]))
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm" + (f", turned {turned:.1f}°" if turned > 0.05 else "")
