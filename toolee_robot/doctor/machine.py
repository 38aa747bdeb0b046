"""Checks of the computer (timing for a servo loop, disk space), and of a UR controller on the network."""

from __future__ import annotations

import os
import platform
import resource
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolee_robot.arm_data import CB3_RATE
from toolee_robot.control import RobotModel
from toolee_robot.control.motion.touch_force import touch_settings
from toolee_robot.devices.ur.checks import UrExpected, check
from toolee_robot.devices.ur.probe import nominal_rate, probe
from toolee_robot.devices.ur.protocols.rtde import RtdeReader
from toolee_robot.devices.ur.servo.clock import PRIORITY
from toolee_robot.devices.ur.setup_checks import calibration_of
from toolee_robot.doctor.frames import JOGGED_POINT, check_frames, check_mounting
from toolee_robot.errors import AssetError, DeviceError, ProtocolError
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.frames import Array
from toolee_robot.perception import ToolPerception
from toolee_robot.station import StationConfig
from toolee_robot.types import DhCalibration

CPUS = 4
"""Recommended number of cores: servo process, task with planner, perception, and the rest of the system."""
DISK_FULL, DISK_LOW = 200 << 20, 5 << 30
"""Free space below which the check fails and warns [bytes]; a job's recording takes some tens of megabytes."""
STOPS = "blocks nothing, but the arm may stop in a motion"
"""Of warnings of this computer."""
LATE = 1e-3
"""Tolerated lateness of a command [s]."""
_GOVERNORS = "cpu*/cpufreq/scaling_governor"


def check_processor(cpus: Path = Path("/sys/devices/system/cpu")) -> Iterator[Finding]:
    """Check the number of cores that this process may use, and their frequency governor.

    Args:
        cpus: The system's folder of the cores.
    """
    n = len(os.sched_getaffinity(0))
    if n < 2:
        yield fail("cores", f"{n}", "the servo loop needs its own core: use a computer with 4")
    elif n < CPUS:
        yield warn("cores", f"{n}", f"{STOPS}: use a computer with {CPUS}")
    else:
        yield ok("cores", f"{n}")
    governors = set()
    for path in cpus.glob(_GOVERNORS):
        with suppress(OSError):
            governors.add(path.read_text().strip())
    if not governors:
        yield ok("frequency", "no governor to set")
    elif governors <= {"performance"}:
        yield ok("frequency", "governor performance")
    else:
        yield warn(
            "frequency",
            f"governor {', '.join(sorted(governors))}",
            f"{STOPS}, as sleeping cores wake late: sudo cpupower frequency-set -g performance",
        )


def check_real_time(rate: float) -> Iterator[Finding]:
    """Check kernel, permissions and timing for a servo loop at `rate` [Hz]; timing is measured for 0.5 s."""
    kernel = "PREEMPT_RT" in platform.version() or _flag("/sys/kernel/realtime")
    limits = "in /etc/security/limits.conf"
    for name, good, fine, wrong, remedy in (
        ("kernel", kernel, "real-time (PREEMPT_RT)", "not a real-time one", "see docs/how-to/first_nail.md"),
        ("priority", _may_schedule(), "SCHED_FIFO is allowed", "SCHED_FIFO is not allowed", f"set rtprio {limits}"),
        ("memory", _may_lock(), "may be locked", "may not be locked", f"set memlock to unlimited {limits}"),
    ):
        yield ok(name, fine) if good else warn(name, wrong, f"{STOPS}: {remedy}")
    late = wake_up_lateness(rate, 0.5)
    p99 = float(np.percentile(late, 99))
    message = (
        f"{rate:.0f} Hz: 99 % of the cycles less than {p99 * 1e3:.2f} ms late, the worst {late.max() * 1e3:.2f} ms"
    )
    if p99 > LATE:
        yield warn("schedule", message, f"{STOPS}: end other programs. Later than half a cycle is an overrun")
    else:
        yield ok("schedule", message)


def check_disk(folder: Path) -> Finding:
    """Check the free disk space of a folder, which need not exist yet."""
    there = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        return fail("recordings", f"{there} cannot be written", "choose another --out")
    free = shutil.disk_usage(there).free
    message = f"{free / 2**30:.1f} GiB free in {folder}"
    if free < DISK_FULL:
        return fail("recordings", message, "make room, or choose another --out")
    if free < DISK_LOW:
        return warn("recordings", message, "make room before a long series")
    return ok("recordings", message)


def wake_up_lateness(rate: float, duration: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Measure how late this process wakes up on an absolute schedule.

    Args:
        rate: Rate of the schedule [Hz].
        duration: Duration of the measurement [s].

    Returns:
        Lateness of every cycle, (n,) [s].
    """
    n = int(rate * duration)
    due = time.monotonic() + np.arange(1, n + 1) / rate
    late = np.zeros(n)
    for i in range(n):
        time.sleep(max(due[i] - time.monotonic(), 0.0))
        late[i] = max(time.monotonic() - due[i], 0.0)
    return late


def _flag(path: str) -> bool:
    with suppress(OSError):
        return Path(path).read_text().strip() == "1"
    return False


def _may_schedule() -> bool:
    """Whether SCHED_FIFO is permitted; tried and undone at once, since permissions have too many sources to be read."""
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return False
    os.sched_setscheduler(0, policy, parameter)
    return True


def _may_lock() -> bool:
    """Whether locking memory is permitted; tried and undone at once."""
    before = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    try:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    except (ValueError, OSError):
        return False
    resource.setrlimit(resource.RLIMIT_MEMLOCK, before)
    return True


def check_weights(folder: Path | None = None) -> Finding:
    """Check that the weights can be loaded.

    Args:
        folder: Folder of the weights; None for the shipped ones.
    """
    began = time.perf_counter()
    try:
        ToolPerception.load(folder)
    except AssetError as error:
        return Finding.of_error("networks", error, "reinstall the package")
    return ok("networks", f"loaded in {time.perf_counter() - began:.1f} s")


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
            raise ProtocolError("the controller does not report actual_TCP_force")
        end = time.monotonic() + DURATION
        readings = []
        while time.monotonic() < end:
            readings.append(reader.read(deadline).values["actual_TCP_force"])
    forces = np.array(readings, dtype=np.float64)
    if len(forces) < FEW or forces.ndim != 2 or not np.all(np.isfinite(forces)):
        raise DeviceError(f"{len(forces)} readings of the force came, which are too few or not finite")
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
    return ok(name, message if force.sd > 1e-6 else f"{message}; no noise, so this is a simulation")


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
        velocity=config.arm.velocity,
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
            findings.append(Finding.of_error("force", error, "check for other RTDE clients and a bad network"))
    return RobotCheck(findings, report.serial, rate, own)
