"""Is this robot the one that was configured, and ready? Each line of the answer says what to do.

Software checks are no safety functions: they find mistakes before motion, they protect nobody.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from toolee_robot.findings import Finding, Level
from toolee_robot.frames import Array
from toolee_robot.hardware.rtde_reader import RTDE_PORT
from toolee_robot.hardware.ur_kinematics import angle_between, tcp_error, worst_error
from toolee_robot.hardware.ur_probe import RtdeQuality, UrReport, UrState
from toolee_robot.robots.dh import DhParameters
from toolee_robot.types import ArmModel, DhCalibration, Payload

ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle, brakes on",
    6: "freedrive",
    7: "running",
    8: "updating firmware",
}
SAFETY_MODES = {
    1: "normal",
    2: "reduced",
    3: "protective stop",
    4: "recovery",
    5: "safeguard stop",
    6: "system emergency stop",
    7: "robot emergency stop",
    8: "violation",
    9: "fault",
    10: "joint identification",
    11: "undefined",
}
_RUNNING, _IDLE, _NORMAL, _PLAYING = 7, 5, 1, 2
_NORMAL_BIT, _TEACH_BIT = 1, 4
_SAFETY_REMEDY = {
    2: "leave reduced mode (the installation's safety planes, inputs): a blow would be stopped in it",
    3: "find out why, then release it at the teach pendant; software never does",
    4: "move the arm back inside its limits by hand, from the teach pendant",
    5: "close the safeguard (the door, the light curtain) and reset it",
    6: "release the emergency stop when the reason is gone, and confirm it at the teach pendant",
    7: "release the emergency stop when the reason is gone, and confirm it at the teach pendant",
}

MASS_TOLERANCE, COG_TOLERANCE = 0.1, 0.02  # [kg], [m]
TCP_TOLERANCE, TCP_ANGLE_TOLERANCE = 1e-3, np.deg2rad(0.5)  # [m], [rad]
ABSURD = 100.0
"""No joint [rad, rad/s] and no TCP [m, rad] reads so much, and arithmetic with what is far more would overflow."""
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


def check(report: UrReport, expected: UrExpected) -> list[Finding]:
    """One finding per thing checked, in the order in which a person would mend them."""
    findings = list(_network(report))
    if not report.reachable:
        return findings
    findings += _identity(report, expected)
    state, quality = report.state, report.quality
    if state is None:
        why = "; ".join(p for p in report.problems if p.startswith("RTDE")) or "no data came"
        return [*findings, _fail("RTDE", why, f"check that port {RTDE_PORT} is open on the robot (Settings, Security)")]
    offset = np.zeros(6) if state.tcp_offset is None else state.tcp_offset
    if not all(np.all(np.abs(v) < ABSURD) for v in (state.q, state.qd, state.tcp_pose, offset)):
        return [*findings, _fail("RTDE", "joints or TCP are not finite, or absurd", "restart the controller")]
    findings += [
        _robot_mode(state),
        _safety(state),
        _remote_control(report),
        *_motion(state),
        _slider(state),
        _payload(state, expected),
        _tcp(state, expected),
        _kinematics(report, state, expected),
    ]
    if quality is None:
        why = "too few readings came to judge the rate"
        return [*findings, _fail("RTDE rate", why, "look for other RTDE clients and a bad network")]
    return [*findings, *_data(quality)]


def _ok(name: str, says: str) -> Finding:
    return Finding(Level.OK, name, says)


def _warn(name: str, says: str, do: str) -> Finding:
    return Finding(Level.WARN, name, says, do)


def _fail(name: str, says: str, do: str) -> Finding:
    return Finding(Level.FAIL, name, says, do)


def _network(report: UrReport) -> Iterator[Finding]:
    if not report.reachable:
        why = next(iter(report.ports.values())).problem
        yield _fail(
            "network", f"no robot at {report.host} ({why})", "check the cable, the address, and that the robot is on"
        )
        return
    closed = [port for port, state in report.ports.items() if state.latency is None]
    latency = max(state.latency for state in report.ports.values() if state.latency is not None) * 1e3
    if closed:
        yield _fail(
            "network",
            f"{report.host} answers, but not on port {', '.join(map(str, closed))}",
            "open these ports (e-Series: Settings, Security, Services); local mode closes 30001 to 30003",
        )
    elif latency > 20.0:
        yield _warn("network", f"connecting took {latency:.0f} ms", "connect by cable, with no other traffic on it")
    else:
        yield _ok("network", f"{report.host} answers on every port, in {latency:.1f} ms")


def _identity(report: UrReport, expected: UrExpected) -> Iterator[Finding]:
    for problem in report.problems:
        if problem.startswith("dashboard"):
            yield _warn("dashboard", problem.removeprefix("dashboard: "), "check that the dashboard server is enabled")
    if report.version is not None:
        yield _version(report.version)
        yield _model(report, report.version, expected)
    if expected.serial is not None:
        if report.serial is None:
            yield _warn("serial number", "the robot does not tell it", f"make sure that it is {expected.serial}")
        elif report.serial != expected.serial:
            yield _fail(
                "serial number",
                f"{report.serial}, the configuration is for {expected.serial}",
                "use this robot's own configuration and calibration",
            )
        else:
            yield _ok("serial number", report.serial)


def _version(version: tuple[int, int, int, int]) -> Finding:
    name, says = "controller version", ".".join(map(str, version))
    major, minor = version[:2]
    if major not in (3, 5) or (major == 3 and minor < 4):
        return _fail(name, f"{says} is not supported", "use PolyScope 3.15 (CB3) or 5.11 to 5.22 (e-Series)")
    if (major == 3 and minor < 15) or (major == 5 and not 11 <= minor < 23):
        return _warn(name, f"{says} was never tried", "3.15 and 5.11 to 5.22 are: test slowly first, or change version")
    return _ok(name, says)


def _model(report: UrReport, version: tuple[int, int, int, int], expected: UrExpected) -> Finding:
    e_series = version[0] > 3
    named = "a robot" if report.model is None else report.model + ("e" if e_series else "")
    generation, article = ("e-Series", "an") if e_series else ("CB3", "a")
    wrong_name = report.model is not None and report.model != "UR10"
    if wrong_name or e_series != (expected.model is ArmModel.UR10E):
        return _fail(
            "robot model",
            f"{named} on {article} {generation} controller, the configuration says {expected.model}",
            "set arm.model in the station file, or connect to the right robot",
        )
    if report.model is None:
        return _warn(
            "robot model", f"this PolyScope does not tell it; the controller is {generation}", "see kinematics"
        )
    return _ok("robot model", f"{named} ({generation})")


def _robot_mode(state: UrState) -> Finding:
    says = ROBOT_MODES.get(state.robot_mode, f"mode {state.robot_mode}")
    if state.robot_mode == _RUNNING:
        return _ok("robot mode", says)
    do = "release the brakes" if state.robot_mode == _IDLE else "power the arm on and release the brakes"
    return _fail("robot mode", says, f"{do} at the teach pendant")


def _safety(state: UrState) -> Finding:
    says = SAFETY_MODES.get(state.safety_mode, f"mode {state.safety_mode}")
    if state.safety_mode == _NORMAL and state.safety_status_bits & _NORMAL_BIT:
        return _ok("safety", says)
    if state.safety_mode == _NORMAL:
        says = f"mode normal, but status bits {state.safety_status_bits:#x}"
    return _fail("safety", says, _SAFETY_REMEDY.get(state.safety_mode, "see the teach pendant's log"))


def _remote_control(report: UrReport) -> Finding:
    name = "remote control"
    if report.version is not None and report.version[0] <= 3:
        return _ok(name, "a CB3 controller has no local mode")
    if report.remote_control is None:
        return _warn(
            name, "the dashboard does not tell", "switch the robot to remote control, top right on the pendant"
        )
    if not report.remote_control:
        return _fail(name, "the robot is in local control", "switch it to remote control, top right on the pendant")
    return _ok(name, "on")


def _motion(state: UrState) -> Iterator[Finding]:
    fastest = float(np.max(np.abs(state.qd)))
    if fastest > 0.02:
        yield _fail("standstill", f"a joint moves at {fastest:.2f} rad/s", "stop whatever moves the robot")
    else:
        yield _ok("standstill", "the arm stands")
    if state.robot_status_bits & _TEACH_BIT:
        yield _fail("freedrive", "the teach button is pressed", "let go of it")
    if state.runtime_state == _PLAYING:
        yield _warn("program", "a program runs on the robot", "stop it: connecting will, and takes its place")
    else:
        yield _ok("program", "none runs")


def _slider(state: UrState) -> Finding:
    says = f"{state.speed_slider:.0%}"
    if not 0.995 <= state.speed_slider <= 1.005:
        return _fail("speed slider", says, "set it to 100 % on the teach pendant: motions are timed for it")
    return _ok("speed slider", says)


def _payload(state: UrState, expected: UrExpected) -> Finding:
    name, is_, wanted = "payload", state.payload, expected.payload
    if is_ is None:
        return _warn(name, "this PolyScope does not tell it", "compare payload and centre of gravity on the pendant")
    says = _payload_text(is_)
    if wanted is None:
        return _ok(name, says)
    off = float(np.linalg.norm(is_.center_of_mass - wanted.center_of_mass))
    # Where next to nothing hangs, its place does not matter.
    if not (abs(is_.mass - wanted.mass) <= MASS_TOLERANCE and (off <= COG_TOLERANCE or wanted.mass <= MASS_TOLERANCE)):
        return _fail(
            name, f"{says}, the configuration says {_payload_text(wanted)}", "set it in the installation's payload page"
        )
    return _ok(name, says)


def _payload_text(payload: Payload) -> str:
    x, y, z = payload.center_of_mass * 1e3
    return f"{payload.mass:.2f} kg at ({x:.0f}, {y:.0f}, {z:.0f}) mm"


def _tcp(state: UrState, expected: UrExpected) -> Finding:
    tcp, wanted = state.tcp_offset, expected.tcp
    if tcp is None:
        return _warn("TCP", "this PolyScope does not tell its offset", "compare it on the teach pendant")
    if wanted is None:
        return _ok("TCP", _tcp_text(tcp))
    apart, turned = float(np.linalg.norm(tcp[:3] - wanted[:3])), angle_between(tcp[3:], wanted[3:])
    if not (apart <= TCP_TOLERANCE and turned <= TCP_ANGLE_TOLERANCE):
        says = f"{_tcp_text(tcp)}, the configuration says {_tcp_text(wanted)}"
        return _fail("TCP", says, "set it in the installation's TCP page")
    return _ok("TCP", _tcp_text(tcp))


def _kinematics(report: UrReport, state: UrState, expected: UrExpected) -> Finding:
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
    says = f"the {'calibrated' if calibrated else 'nominal'} {expected.model} is {off * 1e3:.1f} mm off the arm {where}"
    if off <= FITS:
        return _ok(name, says)
    if off <= FITS_NOMINALLY and not calibrated:
        return _warn(name, says, "set arm.calibration to this arm's own: `toolee doctor --json` prints it")
    fits = {model: error(DhParameters.of(model)) for model in ArmModel}
    best = min(fits, key=lambda model: fits[model])
    if fits[best] <= FITS_NOMINALLY and best is not expected.model:
        return _fail(name, f"{says}; {best} fits to {fits[best] * 1e3:.1f} mm", "set arm.model in the station file")
    if calibrated:
        return _fail(name, says, "arm.calibration is of another arm: `toolee doctor --json` prints this one's")
    return _fail(name, says, "check model and TCP; a joint may have been replaced without a new calibration")


def _tcp_text(tcp: Array) -> str:
    x, y, z = tcp[:3] * 1e3
    turned = np.rad2deg(np.linalg.norm(tcp[3:]))
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm" + (f", turned {turned:.1f}°" if turned > 0.05 else "")


def _data(quality: RtdeQuality) -> Iterator[Finding]:
    q = quality
    network = "use a cable of its own and stop other RTDE clients and other programs"
    if not abs(q.rate / q.asked - 1.0) <= 0.02:
        yield _fail("RTDE rate", f"{q.rate:.1f} Hz, {q.asked:.0f} Hz was asked for", network)
    else:
        yield _ok("RTDE rate", f"{q.rate:.1f} Hz")
    period = 1.0 / q.asked
    share = q.lost / (q.lost + q.samples)
    lost = f"{q.lost} of {q.lost + q.samples} readings lost"
    says = f"99 % of the gaps under {q.gap_p99 * 1e3:.1f} ms, the longest {q.gap_max * 1e3:.1f} ms; {lost}"
    if q.backward or share > 0.1:
        says += f", {q.backward} timestamps do not advance" if q.backward else ""
        yield _fail("RTDE jitter", says, network)
    elif q.lost or q.gap_p99 > 1.5 * period + 1e-3:
        yield _warn("RTDE jitter", says, f"{network}; a gap of 3 cycles ({3e3 * period:.0f} ms) stops a motion")
    else:
        yield _ok("RTDE jitter", says)
    drift = f"the controller's clock runs at {q.clock_ratio:.4f} of this machine's"
    if not abs(q.clock_ratio - 1.0) <= 0.1:
        yield _fail(
            "clock", drift, "the controller does not run in real time: restart it, or the simulator is too slow"
        )
    elif not abs(q.clock_ratio - 1.0) <= 0.02:
        yield _warn("clock", drift, "look for load on this machine and on the network, and try again")
    else:
        yield _ok("clock", drift)
