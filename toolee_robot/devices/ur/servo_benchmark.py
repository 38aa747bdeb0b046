"""Benchmark of the servo loop's timing: one long motion, evaluated by the times of its commands.

    with UnsupervisedUrArm(UrArmConfig("127.0.0.2", longest_motion=660.0), limits) as arm:
        figures, report = servo_benchmark(arm, seconds=600.0)

The arm moves all the time: run it only on a robot with nobody and nothing within reach.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport, MotionWatch
from toolee_robot.types import Trajectory

AMPLITUDE: Final = 0.1  # [rad]
FREQUENCIES: Final = (0.20, 0.23, 0.29, 0.31, 0.37, 0.41)
"""[Hz] Of the joints; different, so that they are never all at rest at once."""
SAMPLE_PERIOD: Final = 0.004  # [s] of the trajectory
_PATIENT: Final = MotionWatch(tracking_error=1.0, data_cycles=500.0, overruns=500)
WARM_UP: Final = 2.0  # [s] before the first measurement of memory


@dataclass(frozen=True)
class ServoFigures:
    """Results of the benchmark.

    Attributes:
        rate: Nominal rate [Hz].
        seconds: Time from the first command to the last [s].
        cycles: Commands sent.
        period_error_p50: Median deviation of the time between two commands from the period [s].
        period_error_p99: 99th percentile of that deviation [s].
        period_error_max: Largest deviation [s].
        overruns: Cycles that the driver reported as late by half a cycle or more.
        drift: Drift of the schedule from the first second to the last [s], see `drift`.
        memory_growth: Growth of the servo process's private memory from WARM_UP to the end [bytes].
        cpu: Mean CPU usage of the servo process [cores].
        fifo: Whether it ran under SCHED_FIFO.
        locked: Whether its memory was locked.
    """

    rate: float
    seconds: float
    cycles: int
    period_error_p50: float
    period_error_p99: float
    period_error_max: float
    overruns: int
    drift: float
    memory_growth: int
    cpu: float
    fifo: bool
    locked: bool


def wave(q: Array, seconds: float) -> Trajectory:
    """A benchmark motion: every joint follows a cosine of its own frequency and returns to its start, at rest.

    Args:
        q: Start and end, (6,) [rad].
        seconds: Duration [s].

    Returns:
        The trajectory.
    """
    turns = np.maximum(np.round(np.array(FREQUENCIES) * seconds), 1.0)
    omega = 2 * np.pi * turns / seconds
    times = np.linspace(0.0, seconds, round(seconds / SAMPLE_PERIOD) + 1)
    phase = times[:, None] * omega
    return Trajectory(
        times,
        q + AMPLITUDE * (1 - np.cos(phase)),
        AMPLITUDE * omega * np.sin(phase),
        AMPLITUDE * omega**2 * np.cos(phase),
    )


def servo_benchmark(arm: UnsupervisedUrArm, seconds: float) -> tuple[ServoFigures, MotionReport]:
    """Execute `wave` without stopping for late cycles, and measure the timing.

    Args:
        arm: A connected arm.
        seconds: Duration of the motion [s].

    Returns:
        The results, and the motion's report.

    Raises:
        DeviceError: As `UnsupervisedUrArm.execute` raises it.
    """
    pid, realtime = arm.servo_pid, arm.realtime
    memory: list[int] = []
    ended = threading.Event()

    def sample_memory() -> None:
        ended.wait(WARM_UP)
        memory.append(_private_memory(pid))
        ended.wait()
        memory.append(_private_memory(pid))

    watcher = threading.Thread(target=sample_memory, daemon=True)
    cpu = cpu_time(pid)
    watcher.start()
    try:
        report = arm.execute(wave(arm.state().q_commanded, seconds), None, _PATIENT)
        cpu = cpu_time(pid) - cpu
    finally:
        ended.set()
        watcher.join()
    period = 1.0 / arm.rate
    stamps = report.stamps
    steps = np.diff(stamps)
    error = np.abs(steps - period)
    figures = ServoFigures(
        rate=arm.rate,
        seconds=float(stamps[-1] - stamps[0]),
        cycles=len(stamps),
        period_error_p50=float(np.percentile(error, 50)),
        period_error_p99=float(np.percentile(error, 99)),
        period_error_max=float(error.max()),
        overruns=report.overruns,
        drift=drift(stamps, period),
        memory_growth=memory[1] - memory[0],
        cpu=cpu / float(stamps[-1] - stamps[0]),
        fifo=realtime.fifo,
        locked=realtime.locked,
    )
    return figures, report


def drift(stamps: Array, period: float) -> float:
    """Drift of a command schedule from its first second to its last whole second.

    The commands' mean phase within the period is tracked from second to second, so that single late or missed commands
    have no effect, while a drift of more than a period is still measured.

    Args:
        stamps: Times of the commands, (N,) [s].
        period: Nominal period [s].

    Returns:
        The drift [s].

    Raises:
        ValueError: The stamps cover less than two seconds.
    """
    turn = np.exp(2j * np.pi * (stamps - stamps[0]) / period)
    phases = []
    for part in np.split(turn, np.searchsorted(stamps, np.arange(stamps[0] + 1.0, stamps[-1])))[:-1]:
        mean = np.sum(part)
        phases.append(np.angle(mean) + np.median(np.angle(part / mean)))
    if not phases:
        raise ValueError("drift needs two seconds")
    return float((np.unwrap(phases)[-1] - phases[0]) / (2 * np.pi) * period)


def _private_memory(pid: int) -> int:
    """Resident memory of a process that is not shared [bytes]."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return 1024 * int(line.split()[1])
    return 0


def cpu_time(pid: int) -> float:
    """CPU time that a process has used [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
