"""What a person enters once into a robot's installation, and the factory into its arm: payload, TCP, kinematics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.frames import Array
from toolee_robot.hardware.ur.kinematics import angle_between, tcp_error, worst_error
from toolee_robot.hardware.ur.probe import UrReport, UrState
from toolee_robot.robots.dh import DhParameters
from toolee_robot.types import ArmModel, DhCalibration, Payload

MASS_TOLERANCE, COG_TOLERANCE = 0.1, 0.02  # [kg], [m]
TCP_TOLERANCE, TCP_ANGLE_TOLERANCE = 1e-3, np.deg2rad(0.5)  # [m], [rad]
FITS, FITS_NOMINALLY = 1e-3, 0.02
"""[m] What agrees; and how far an arm may be from its nominal model. UR10 and UR10e are 50 mm apart."""


@dataclass(frozen=True)
class UrExpected:
    """What the configuration says. calibration: the arm's own kinematics, None for the nominal ones. payload, tcp (6,)
    ([m], rotation vector [rad], flange frame), serial: None where it is not to be checked."""

    model: ArmModel
    calibration: DhCalibration | None = None
    payload: Payload | None = None
    tcp: Array | None = None
    serial: str | None = None


def check_payload(state: UrState, expected: UrExpected) -> Finding:
    """Mass and centre of gravity in the installation, as it is before any program sets its own."""
    name, is_, wanted = "payload", state.payload, expected.payload
    if is_ is None:
        return warn(name, "this PolyScope does not tell it", "compare payload and centre of gravity on the pendant")
    message = _payload_text(is_)
    if wanted is None:
        return ok(name, message)
    off = float(np.linalg.norm(is_.center_of_mass - wanted.center_of_mass))
    # Where next to nothing hangs, its place does not matter.
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
    """Its place in the flange."""
    tcp, wanted = state.tcp_offset, expected.tcp
    if tcp is None:
        return warn("TCP", "this PolyScope does not tell its offset", "compare it on the teach pendant")
    if wanted is None:
        return ok("TCP", _tcp_text(tcp))
    apart, turned = float(np.linalg.norm(tcp[:3] - wanted[:3])), angle_between(tcp[3:], wanted[3:])
    if not (apart <= TCP_TOLERANCE and turned <= TCP_ANGLE_TOLERANCE):
        message = f"{_tcp_text(tcp)}, the configuration says {_tcp_text(wanted)}"
        return fail("TCP", message, "set it in the installation's TCP page")
    return ok("TCP", _tcp_text(tcp))


def check_kinematics(report: UrReport, state: UrState, expected: UrExpected) -> Finding:
    """By the controller's own parameters where it tells them, otherwise by where it says that the TCP is now."""
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
    if off <= FITS:
        return ok(name, message)
    if off <= FITS_NOMINALLY and not calibrated:
        return warn(name, message, "set arm.calibration to this arm's own: `toolee doctor --json` prints it")
    fits = {model: error(DhParameters.of(model)) for model in ArmModel}
    best = min(fits, key=lambda model: fits[model])
    if fits[best] <= FITS_NOMINALLY and best is not expected.model:
        return fail(name, f"{message}; {best} fits to {fits[best] * 1e3:.1f} mm", "set arm.model in the station file")
    if calibrated:
        return fail(name, message, "arm.calibration is of another arm: `toolee doctor --json` prints this one's")
    return fail(name, message, "check model and TCP; a joint may have been replaced without a new calibration")


def _tcp_text(tcp: Array) -> str:
    x, y, z = tcp[:3] * 1e3
    turned = np.rad2deg(np.linalg.norm(tcp[3:]))
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm" + (f", turned {turned:.1f}°" if turned > 0.05 else "")
