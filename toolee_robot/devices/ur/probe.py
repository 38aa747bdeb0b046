"""Read-only probe of a UR controller: identity, state, data quality.

    report = probe("192.168.1.10")
    findings = check(report, UrExpected(model=ArmModel.UR10))  # checks.py

Queries the dashboard server, reads the arm's kinematics from the primary interface, and receives RTDE data for a
second. It uploads no script and takes no input register. It raises nothing for what the robot does or does not answer:
unknown values are None, and `problems` tells why.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.arm_data import CB3_RATE, E_SERIES_RATE
from toolee_robot.devices.ur.protocols.rtde import RTDE_PORT, RtdeReader, RtdeSample, Value
from toolee_robot.devices.ur.protocols.tcp import (
    DASHBOARD_PORT,
    PRIMARY_PORT,
    Question,
    UrKinematics,
    ask_all,
    connect,
    read_kinematics,
)
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import HostClock
from toolee_robot.types import Payload


@dataclass(frozen=True)
class PortState:
    """Result of connecting to one port.

    Attributes:
        latency: Time to connect [s]; None if it failed.
        problem: Why it failed; empty otherwise.
    """

    latency: float | None
    problem: str = ""


@dataclass(frozen=True)
class UrState:
    """One reading of the robot's state.

    Attributes:
        q: Joint positions, (6,) [rad].
        qd: Joint velocities, (6,) [rad/s].
        tcp_pose: TCP in the controller's base, (6,): position [m], rotation vector [rad].
        tcp_offset: TCP in the flange frame, (6,), likewise; None if this version of PolyScope does not report it.
        payload: Payload in the flange frame; None if this version of PolyScope does not report it.
        robot_mode: RTDE's robot_mode.
        safety_mode: RTDE's safety_mode.
        runtime_state: RTDE's runtime_state.
        robot_status_bits: RTDE's robot_status_bits.
        safety_status_bits: RTDE's safety_status_bits.
        speed_slider: Position of the speed slider, 0 to 1.
        accelerometer: Mean of the tool's accelerometer, (3,) [m/s^2], axes of the tool, upwards at rest; None if the
            controller does not report it.
    """

    q: Array
    qd: Array
    tcp_pose: Array
    tcp_offset: Array | None
    payload: Payload | None
    robot_mode: int
    safety_mode: int
    runtime_state: int
    robot_status_bits: int
    safety_status_bits: int
    speed_slider: float
    accelerometer: Array | None = None


@dataclass(frozen=True)
class RtdeQuality:
    """Timing of about a second of RTDE data.

    Attributes:
        asked: Requested rate [Hz].
        rate: Rate by the controller's timestamps [Hz].
        samples: Samples received.
        lost: Samples missing by the timestamps.
        backward: Timestamps that did not advance.
        gap_p99: 99th percentile of the time between two arrivals at this machine [s].
        gap_max: Longest time between two arrivals [s].
        clock_ratio: Seconds of the controller's clock per second of this machine's.
    """

    asked: float
    rate: float
    samples: int
    lost: int
    backward: int
    gap_p99: float
    gap_max: float
    clock_ratio: float


@dataclass(frozen=True)
class UrReport:
    """Everything that a probe has read; None where unknown.

    Attributes:
        host: Address of the controller.
        ports: Result of connecting, by port.
        version: Version of URControl: major, minor, bugfix, build.
        model: Model, as the dashboard reports it, without the e of the e-Series.
        serial: Serial number, as the dashboard reports it.
        remote_control: Whether the robot is in remote control; None on a CB3, which has no local mode.
        state: Latest state.
        quality: Timing of the RTDE data.
        kinematics: Calibrated kinematics of the arm.
        problems: What could not be read, and why.
    """

    host: str
    ports: dict[int, PortState]
    version: tuple[int, int, int, int] | None
    model: str | None
    serial: str | None
    remote_control: bool | None
    state: UrState | None
    quality: RtdeQuality | None
    kinematics: UrKinematics | None
    problems: tuple[str, ...]

    @property
    def reachable(self) -> bool:
        """Whether any port accepted a connection."""
        return any(port.latency is not None for port in self.ports.values())


SCRIPT_PORTS = (PRIMARY_PORT, 30002, 30003)

_QUESTIONS: tuple[Question, ...] = (
    "get robot model",
    "get serial number",
    "is in remote control",
)
_ALWAYS = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_pose",
    "robot_mode",
    "safety_mode",
    "robot_status_bits",
    "safety_status_bits",
    "runtime_state",
    "target_speed_fraction",
)
_ACCELEROMETER = "actual_tool_accelerometer"
_OPTIONAL = ("tcp_offset", "payload", "payload_cog", _ACCELEROMETER)  # payload since 3.11 and 5.5.1


def nominal_rate(version: tuple[int, int, int, int]) -> float:
    """RTDE and servo rate [Hz] of a controller with this version of URControl (major, minor, bugfix, build)."""
    return E_SERIES_RATE if version[0] > 3 else CB3_RATE


def probe(host: str, timeout: float = 3.0, listen: float = 1.0, clock: HostClock | None = None) -> UrReport:
    """Probe a controller; takes about 1.2 s on a robot that answers.

    Args:
        host: Address of the controller.
        timeout: Longest duration in all [s].
        listen: Duration of receiving RTDE data [s].
        clock: The clock of these times, the robot's; the wall clock if None.

    Returns:
        What was read.
    """
    clock = clock or HostClock()
    timeout, listen = clock.to_wall_time(timeout), clock.to_wall_time(listen)
    deadline = time.monotonic() + timeout
    ports: dict[int, PortState] = {}
    for port in (RTDE_PORT, DASHBOARD_PORT, *SCRIPT_PORTS):
        ports[port] = _knock(host, port, min(deadline, time.monotonic() + timeout / 10))
    problems: list[str] = []
    answers: dict[Question, str | None] = {}
    if ports[DASHBOARD_PORT].latency is not None:
        try:
            answers = ask_all(host, _QUESTIONS, min(deadline, time.monotonic() + timeout / 5))
        except DeviceError as error:
            problems.append(f"dashboard: {error}")
    version, samples, asked = None, list[RtdeSample](), 0.0
    if ports[RTDE_PORT].latency is not None:
        try:
            version, asked = _version(host, deadline)
            samples = _listen(host, asked, deadline, listen)
        except DeviceError as error:
            problems.append(f"RTDE: {error}")
    state, quality = None, None
    if samples:
        try:
            state = replace(_state(samples[-1].values), accelerometer=_accelerometer(samples))
        except (TypeError, ValueError, OverflowError) as error:
            problems.append(f"RTDE: a variable has another type than documented ({error})")
        else:
            quality = _quality(samples, asked, clock)
    kinematics = None
    if ports[PRIMARY_PORT].latency is not None:
        try:
            kinematics = read_kinematics(host, min(deadline, time.monotonic() + timeout / 5))
        except DeviceError as error:
            problems.append(f"primary interface: {error}")
    remote = answers.get("is in remote control")
    model = answers.get("get robot model")
    return UrReport(
        host=host,
        ports=ports,
        version=version,
        model=None if model is None else model.strip().upper().removesuffix("E"),
        serial=answers.get("get serial number"),
        remote_control=None if remote is None else remote.strip().lower() == "true",
        state=state,
        quality=quality,
        kinematics=kinematics,
        problems=tuple(problems),
    )


def _knock(host: str, port: int, deadline: float) -> PortState:
    began = time.monotonic()
    try:
        connect(host, port, deadline).close()
    except DeviceError as error:
        return PortState(None, str(error))
    return PortState(time.monotonic() - began)


def _version(host: str, deadline: float) -> tuple[tuple[int, int, int, int], float]:
    with RtdeReader.connect(host, deadline) as reader:
        version = reader.version(deadline)
    return version, nominal_rate(version)


def _listen(host: str, rate: float, deadline: float, duration: float) -> list[RtdeSample]:
    """Receive data for about `duration` [s], less if the deadline comes first.

    Outputs that the controller does not know are omitted on a second connection, since a recipe cannot be corrected.
    """
    names = [*_ALWAYS, *_OPTIONAL]
    for _ in range(2):
        with RtdeReader.connect(host, deadline) as reader:
            unknown = reader.subscribe(names, rate, deadline)
            if not unknown:
                samples = [reader.read(deadline)]
                while samples[-1].received - samples[0].received < duration and time.monotonic() < deadline - 0.1:
                    samples.append(reader.read(deadline))
                return samples
        names = [name for name in names if name not in unknown]
        if missing := set(_ALWAYS) - set(names):
            message = f"this controller does not know {', '.join(sorted(missing))}: update PolyScope"
            raise DeviceError(message)
    raise DeviceError("the controller's set of known outputs changed")


def _state(values: dict[str, Value]) -> UrState:
    payload = None
    if "payload" in values and "payload_cog" in values:
        payload = Payload(_number(values["payload"]), _vector(values["payload_cog"], 3))
    return UrState(
        q=_vector(values["actual_q"], 6),
        qd=_vector(values["actual_qd"], 6),
        tcp_pose=_vector(values["actual_TCP_pose"], 6),
        tcp_offset=_vector(values["tcp_offset"], 6) if "tcp_offset" in values else None,
        payload=payload,
        robot_mode=int(_number(values["robot_mode"])),
        safety_mode=int(_number(values["safety_mode"])),
        runtime_state=int(_number(values["runtime_state"])),
        robot_status_bits=int(_number(values["robot_status_bits"])),
        safety_status_bits=int(_number(values["safety_status_bits"])),
        speed_slider=_number(values["target_speed_fraction"]),
    )


def _accelerometer(samples: list[RtdeSample]) -> Array | None:
    """Mean over the samples, (3,) [m/s^2]: one reading is noisy."""
    if _ACCELEROMETER not in samples[-1].values:
        return None
    return np.asarray(np.mean([_vector(sample.values[_ACCELEROMETER], 3) for sample in samples], axis=0))


def _number(value: Value) -> float:
    if isinstance(value, tuple):
        raise TypeError(f"expected one number, not {len(value)}")
    return float(value)


def _vector(value: Value, n: int) -> Array:
    if not isinstance(value, tuple) or len(value) != n:
        raise TypeError(f"expected {n} numbers")
    return np.array(value, float)


def _quality(samples: list[RtdeSample], asked: float, clock: HostClock) -> RtdeQuality | None:
    """Timing of the samples; None if there are too few."""
    if len(samples) < 10:
        return None
    stamps = np.array([_number(s.values["timestamp"]) for s in samples])
    received = clock.real_time_factor * np.array([s.received for s in samples])
    steps, gaps = np.diff(stamps), np.diff(received)
    if not np.all(np.isfinite(stamps)):
        return None
    forward = steps[steps > 0]
    period = float(np.median(forward)) if len(forward) else float("inf")
    lost = int(np.sum(np.maximum(np.rint(forward * asked) - 1, 0))) if len(forward) else 0
    elapsed = received - received.mean()
    return RtdeQuality(
        asked=asked,
        rate=1.0 / period,
        samples=len(samples),
        lost=lost,
        backward=int(np.sum(steps <= 0)),
        gap_p99=float(np.percentile(gaps, 99)),
        gap_max=float(gaps.max()),
        clock_ratio=float(elapsed @ (stamps - stamps.mean()) / max(float(elapsed @ elapsed), 1e-12)),
    )
