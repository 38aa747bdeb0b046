"""Checks of a robot's installation (payload, TCP) and of its arm's calibrated kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.arm_data import JOINTS
from toolee_robot.devices.ur.probe import UrReport, UrState
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.frames import Array, transform
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.types import ArmModel, DhCalibration, Payload

ANGLE_ARM = 0.1
"""[m] Lever arm by which an orientation error is converted to a distance: the hand's length."""


def pose_matrix(pose: Array) -> Array:
    """4x4 of a UR pose (6,): position [m] and rotation vector [rad]."""
    return transform(Rotation.from_rotvec(pose[3:]).as_matrix(), pose[:3])


def angle_between(a: Array, b: Array) -> float:
    """Angle of the rotation between two orientations.

    Args:
        a: An orientation as rotation vector, (3,) [rad].
        b: The other orientation, (3,) [rad].

    Returns:
        The angle in [0, pi] [rad].
    """
    return float((Rotation.from_rotvec(a).inv() * Rotation.from_rotvec(b)).magnitude())


def pose_error(X: Array, Y: Array) -> float:
    """Distance between two poses, with the rotation weighted by ANGLE_ARM.

    Args:
        X: A pose, (4, 4).
        Y: The other pose, in the same frame, (4, 4).

    Returns:
        The distance [m].
    """
    turned = Rotation.from_matrix(X[:3, :3].T @ Y[:3, :3]).magnitude()
    return float(np.hypot(np.linalg.norm(X[:3, 3] - Y[:3, 3]), ANGLE_ARM * turned))


def tcp_error(dh: DhParameters, q: Array, tcp_offset: Array, tcp_pose: Array) -> float:
    """Deviation of a predicted TCP pose from the one that the controller reports.

    Args:
        dh: Kinematic parameters of the arm.
        q: Joint positions, (6,) [rad].
        tcp_offset: TCP in the flange frame, (6,): position [m], rotation vector [rad].
        tcp_pose: TCP in the controller's base, (6,), likewise.

    Returns:
        The deviation [m], see `pose_error`.
    """
    return pose_error(dh.fk(q) @ pose_matrix(tcp_offset), pose_matrix(tcp_pose))


def worst_error(a: DhParameters, b: DhParameters) -> float:
    """Largest deviation between two arms' flange poses over 30 random configurations.

    Args:
        a: Parameters of one arm.
        b: Parameters of the other arm.

    Returns:
        The deviation [m], as in `pose_error`.
    """
    qs = np.random.default_rng(0).uniform(-np.pi, np.pi, (30, 6))
    return max(pose_error(a.fk(q), b.fk(q)) for q in qs)


def calibration_of(dh: DhParameters, model: ArmModel) -> DhCalibration:
    """The calibration of an arm: the value of `arm.calibration` in the station file.

    Args:
        dh: Calibrated kinematic parameters of the arm.
        model: Model of the arm.

    Returns:
        Differences from the model's nominal parameters.
    """
    nominal = DhParameters.of(model)

    def delta(own: Array, of_model: Array) -> tuple[float, float, float, float, float, float]:
        a, b, c, d, e, f = (own - of_model).tolist()
        return a, b, c, d, e, f

    return DhCalibration(
        delta_theta=delta(dh.theta, nominal.theta),
        delta_a=delta(dh.a, nominal.a),
        delta_d=delta(dh.d, nominal.d),
        delta_alpha=delta(dh.alpha, nominal.alpha),
    )


MASS_TOLERANCE, COG_TOLERANCE = 0.1, 0.02  # [kg], [m]
TCP_TOLERANCE, TCP_ANGLE_TOLERANCE = 1e-3, np.deg2rad(0.5)  # [m], [rad]
SPEED_TOLERANCE, RANGE = 0.01, 2.0 * np.pi - 0.01  # [rad/s], [rad]: half the range of a joint
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
        velocity: Largest velocity of each joint that is planned with, (6,) [rad/s].
    """

    model: ArmModel
    calibration: DhCalibration | None = None
    payload: Payload | None = None
    tcp: Array | None = None
    serial: str | None = None
    velocity: Sequence[float] | None = None


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
    return f"{payload.mass:.2f} kg at ({x:z.0f}, {y:z.0f}, {z:z.0f}) mm"


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


def check_ranges(report: UrReport, expected: UrExpected) -> list[Finding]:
    """Compare what the robot permits its joints with what motions are planned with.

    Args:
        report: What a probe has read from the robot.
        expected: What the configuration requires.

    Returns:
        One finding; none if the robot does not report its limits.
    """
    ranges = None if report.kinematics is None else report.kinematics.ranges
    if ranges is None or expected.velocity is None:
        return []
    name, less = "joint limits", []
    for joint, low, high, most, planned in zip(
        JOINTS, ranges.lower, ranges.upper, ranges.speed, expected.velocity, strict=True
    ):
        if planned > most + SPEED_TOLERANCE:
            less.append(f"{joint} {np.rad2deg(most):.0f}°/s, arm.velocity has {np.rad2deg(planned):.0f}°/s")
        if low > -RANGE or high < RANGE:
            less.append(f"{joint} {np.rad2deg(low):.0f}° to {np.rad2deg(high):.0f}°, planned is ±360°")
    if not less:
        return [ok(name, "the robot permits what motions are planned with")]
    hint = "it would stop itself: lower arm.velocity, or widen the limits of the safety configuration"
    return [warn(name, f"the robot permits {'; '.join(less)}", hint)]


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
        return warn(name, message, "`toolee doctor --write` enters this arm's own (arm.calibration)")
    fits = {model: error(DhParameters.of(model)) for model in ArmModel}
    best = min(fits, key=lambda model: fits[model])
    if fits[best] <= NOMINAL_TOLERANCE and best is not expected.model:
        return fail(name, f"{message}; {best} fits to {fits[best] * 1e3:.1f} mm", "set arm.model in the station file")
    if calibrated:
        return fail(name, message, "arm.calibration is of another arm: `toolee doctor --write` enters this one's")
    return fail(name, message, "check model and TCP; a joint may have been replaced without a new calibration")


def _tcp_text(tcp: Array) -> str:
    x, y, z = tcp[:3] * 1e3
    turned = np.rad2deg(np.linalg.norm(tcp[3:]))
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm" + (f", turned {turned:.1f}°" if turned > 0.05 else "")
