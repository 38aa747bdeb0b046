"""Checks that a robot is the configured one and ready; every failed finding contains its remedy.

These checks are not safety functions: they find mistakes before a motion, they protect nobody.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.probe import RtdeQuality, UrReport, UrState, probe
from toolee_robot.devices.ur.protocols.rtde import RTDE_PORT
from toolee_robot.devices.ur.setup_checks import UrExpected, check_kinematics, check_payload, check_ranges, check_tcp
from toolee_robot.devices.ur.status import RUNTIME_PAUSED
from toolee_robot.errors import NotReadyError
from toolee_robot.findings import Finding, Level, fail, ok, warn
from toolee_robot.station import ArmLimits
from toolee_robot.types import ArmModel

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
_RUNNING, _NORMAL, _PLAYING = 7, 1, 2
_NORMAL_BIT, _TEACH_BIT = 1, 4
_MODE_REMEDY = {
    1: "confirm the safety configuration at the teach pendant",
    2: "wait until the controller has started",
    5: "release the brakes at the teach pendant",
    6: "let go of the freedrive button",
    8: "wait until the update is done",
}
_SAFETY_REMEDY = {
    2: "leave reduced mode (the installation's safety planes, inputs): it would stop a strike",
    3: "find out why, then release it at the teach pendant; software never does",
    4: "move the arm back inside its limits by hand, from the teach pendant",
    5: "close the safeguard (the door, the light curtain) and reset it",
    6: "when it is safe, release the emergency stop, and confirm it at the teach pendant",
    7: "when it is safe, release the emergency stop, and confirm it at the teach pendant",
}

IMPLAUSIBLE = 100.0
"""Bound of plausible joint [rad, rad/s] and TCP [m, rad] readings; far larger values would overflow in arithmetic."""

LOST = 0.3
"""Fraction of lost readings above which load on this machine is no explanation."""
CLOCK_WARNING, CLOCK_FAILURE = 0.02, 0.3
"""Deviation of the clock ratio from 1: more than a stall of either machine explains, and not in real time at all."""

__all__ = ["UrExpected", "check"]


def check(report: UrReport, expected: UrExpected) -> list[Finding]:
    """Check a robot against its configuration.

    Args:
        report: What a probe has read from the robot.
        expected: What the configuration requires.

    Returns:
        One finding per check, in the order in which a person would fix them.
    """
    findings = list(_network(report))
    if not report.reachable:
        return findings
    findings += _identity(report, expected)
    state, quality = report.state, report.quality
    if state is None:
        why = "; ".join(p for p in report.problems if p.startswith("RTDE")) or "no data came"
        hint = f"check that nothing blocks port {RTDE_PORT}; an e-Series enables it under Settings, Security"
        return [*findings, fail("RTDE", why, hint)]
    offset = np.zeros(6) if state.tcp_offset is None else state.tcp_offset
    if not all(np.all(np.abs(v) < IMPLAUSIBLE) for v in (state.q, state.qd, state.tcp_pose, offset)):
        return [*findings, fail("RTDE", "joints or TCP are not finite, or implausible", "restart the controller")]
    findings += [
        _robot_mode(state),
        _safety(state),
        _remote_control(report),
        *_motion(state),
        _slider(state),
        check_payload(state, expected),
        check_tcp(state, expected),
        check_kinematics(report, state, expected),
        *check_ranges(report, expected),
    ]
    if quality is None:
        why = "too few readings came to judge the rate"
        return [*findings, fail("RTDE rate", why, "check for other RTDE clients and a bad network")]
    return [*findings, *_data(quality)]


def _network(report: UrReport) -> Iterator[Finding]:
    if not report.reachable:
        why = next(iter(report.ports.values())).problem
        yield fail(
            "network", f"no robot at {report.host} ({why})", "check the cable, the address, and that the robot is on"
        )
        return
    closed = [port for port, state in report.ports.items() if state.latency is None]
    latency = max(state.latency for state in report.ports.values() if state.latency is not None) * 1e3
    if closed:
        yield fail(
            "network",
            f"{report.host} answers, but not on port {', '.join(map(str, closed))}",
            "open these ports (e-Series: Settings, Security, Services); local mode closes 30001 to 30003",
        )
    elif latency > 20.0:
        yield warn("network", f"connecting took {latency:.0f} ms", "connect by cable, with no other traffic on it")
    else:
        yield ok("network", f"{report.host} answers on every port, in {latency:.1f} ms")


def _identity(report: UrReport, expected: UrExpected) -> Iterator[Finding]:
    for problem in report.problems:
        if problem.startswith("dashboard"):
            yield warn("dashboard", problem.removeprefix("dashboard: "), "check that the dashboard server is enabled")
    if report.version is not None:
        yield _version(report.version)
        yield _model(report, report.version, expected)
    if expected.serial is not None:
        if report.serial is None:
            yield warn("serial number", "the robot does not report it", f"make sure that it is {expected.serial}")
        elif report.serial != expected.serial:
            yield fail(
                "serial number",
                f"{report.serial}, the configuration is for {expected.serial}",
                "use this robot's own configuration and calibration",
            )
        else:
            yield ok("serial number", report.serial)


def _version(version: tuple[int, int, int, int]) -> Finding:
    name, message = "controller version", ".".join(map(str, version))
    major, minor = version[:2]
    if major not in (3, 5) or (major == 3 and minor < 4):
        return fail(name, f"{message} is not supported", "use PolyScope 3.15 (CB3) or 5.11 to 5.22 (e-Series)")
    if (major == 3 and minor < 15) or (major == 5 and not 11 <= minor < 23):
        return warn(
            name, f"{message} is untested", "3.15 and 5.11 to 5.22 are tested: move slowly first, or change version"
        )
    return ok(name, message)


def _model(report: UrReport, version: tuple[int, int, int, int], expected: UrExpected) -> Finding:
    e_series = version[0] > 3
    named = "a robot" if report.model is None else report.model + ("e" if e_series else "")
    generation, article = ("e-Series", "an") if e_series else ("CB3", "a")
    wrong_name = report.model is not None and report.model != "UR10"
    if wrong_name or e_series != (expected.model is ArmModel.UR10E):
        return fail(
            "robot model",
            f"{named} on {article} {generation} controller, the configuration says {expected.model}",
            "set arm.model in the station file, or connect to the right robot",
        )
    if report.model is None:
        message = f"this PolyScope does not report it; the controller is {generation}"
        return warn("robot model", message, "see kinematics")
    return ok("robot model", f"{named} ({generation})")


def _robot_mode(state: UrState) -> Finding:
    message = ROBOT_MODES.get(state.robot_mode, f"mode {state.robot_mode}")
    if state.robot_mode == _RUNNING:
        return ok("robot mode", message)
    remedy = _MODE_REMEDY.get(state.robot_mode, "power the arm on and release the brakes, at the teach pendant")
    return fail("robot mode", message, remedy)


def _safety(state: UrState) -> Finding:
    message = SAFETY_MODES.get(state.safety_mode, f"mode {state.safety_mode}")
    if state.safety_mode == _NORMAL and state.safety_status_bits & _NORMAL_BIT:
        return ok("safety", message)
    if state.safety_mode == _NORMAL:
        message = f"mode normal, but status bits {state.safety_status_bits:#x}"
    return fail("safety", message, _SAFETY_REMEDY.get(state.safety_mode, "see the teach pendant's log"))


def _remote_control(report: UrReport) -> Finding:
    name = "remote control"
    if report.version is not None and report.version[0] <= 3:
        return ok(name, "a CB3 controller has no local mode")
    if report.remote_control is None:
        remedy = "switch the robot to remote control, top right on the pendant"
        return warn(name, "the dashboard does not report it", remedy)
    if not report.remote_control:
        return fail(name, "the robot is in local control", "switch it to remote control, top right on the pendant")
    return ok(name, "on")


def _motion(state: UrState) -> Iterator[Finding]:
    fastest = float(np.max(np.abs(state.qd)))
    if fastest > 0.02:
        yield fail("standstill", f"a joint moves at {fastest:.2f} rad/s", "stop what moves the robot")
    else:
        yield ok("standstill", "the arm is at rest")
    if state.robot_status_bits & _TEACH_BIT:
        yield fail("freedrive", "the teach button is pressed", "let go of it")
    if state.runtime_state in RUNTIME_PAUSED:
        remedy = "stop it at the pendant: Play would move the arm to the program's last target"
        yield fail("program", "a paused program waits on the robot", remedy)
    elif state.runtime_state == _PLAYING:
        yield warn("program", "a program runs on the robot", "stop it: connecting stops and replaces it")
    else:
        yield ok("program", "none runs")


def _slider(state: UrState) -> Finding:
    message = f"{state.speed_slider:.0%}"
    if not 0.995 <= state.speed_slider <= 1.005:
        return fail("speed slider", message, "set it to 100 % on the teach pendant: motions are timed for it")
    return ok("speed slider", message)


def _data(quality: RtdeQuality) -> Iterator[Finding]:
    q = quality
    network = "use a dedicated cable and stop other RTDE clients and other programs"
    if not abs(q.rate / q.asked - 1.0) <= 0.02:
        yield fail("RTDE rate", f"{q.rate:.1f} Hz, {q.asked:.0f} Hz requested", network)
    else:
        yield ok("RTDE rate", f"{q.rate:.1f} Hz")
    period = 1.0 / q.asked
    share = q.lost / (q.lost + q.samples)
    lost = f"{q.lost} of {q.lost + q.samples} readings lost"
    message = f"99 % of the gaps under {q.gap_p99 * 1e3:.1f} ms, the longest {q.gap_max * 1e3:.1f} ms; {lost}"
    if q.backward or share > LOST:
        message += f", {q.backward} timestamps do not advance" if q.backward else ""
        yield fail("RTDE jitter", message, network)
    elif q.lost or q.gap_p99 > 1.5 * period + 1e-3:
        yield warn("RTDE jitter", message, f"{network}; a gap of 3 cycles ({3e3 * period:.0f} ms) stops a motion")
    else:
        yield ok("RTDE jitter", message)
    drift = f"the controller's clock runs at {q.clock_ratio:.4f} of this machine's"
    if not abs(q.clock_ratio - 1.0) <= CLOCK_FAILURE:
        yield fail("clock", drift, "the controller does not run in real time: restart it, or the simulator is too slow")
    elif not abs(q.clock_ratio - 1.0) <= CLOCK_WARNING:
        yield warn("clock", drift, "reduce the load on this machine and on the network, and try again")
    else:
        yield ok("clock", drift)


PROBES: Final = 3
TIMING: Final = {"RTDE rate", "RTDE jitter", "clock"}
"""Names of the findings that load on this machine can cause; if only these fail, the probe is repeated, up to PROBES
times in all."""


@dataclass(frozen=True)
class Identity:
    """Which robot answered.

    Attributes:
        version: Version of the controller's software: major, minor, bugfix, build.
        serial: Serial number; None from a controller that does not report it.
    """

    version: tuple[int, int, int, int]
    serial: str | None


def require_ready(
    config: UrArmConfig, limits: ArmLimits, before: Identity | None = None, *, payload_set: bool = False
) -> Identity:
    """Probe the robot and check it against the configuration; nothing moves.

    Args:
        config: Address and expected installation of the robot.
        limits: Expected model and calibration.
        before: The robot of an earlier connection, which it must be; the TCP is then the driver's own, which sets it
            again and reads it back. None for the first connection, when it is the installation's.
        payload_set: Whether the driver has set a payload of its own, likewise.

    Returns:
        Which robot it is.

    Raises:
        NotReadyError: A check failed; the message lists everything a person must do first.
    """
    expected = UrExpected(limits.model, limits.calibration, payload=None if payload_set else config.payload)
    if before is not None:
        expected = replace(expected, serial=before.serial)
    elif config.tcp is not None:
        expected = replace(expected, tcp=np.array(config.tcp))
    for _ in range(PROBES):
        report = probe(config.host, clock=config.clock)
        failed = [finding for finding in check(report, expected) if finding.level is Level.FAIL]
        # Load on this machine during the probe is no fault of the robot; a controller clock that runs backwards or is
        # not reported is.
        quality = report.quality
        load_only = quality is not None and not quality.backward and all(f.name in TIMING for f in failed)
        if not failed or not load_only:
            break
    if failed or report.version is None:
        lines = "\n  ".join(map(str, failed))
        message = f"the robot at {config.host} is not ready:\n  {lines}"
        if failed and load_only:
            raise NotReadyError(message, code="not_ready.timing")
        raise NotReadyError(message, code="not_ready.checks_failed")
    return Identity(report.version, report.serial)
