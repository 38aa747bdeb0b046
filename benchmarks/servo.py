"""Timing and tracking of the driver's servo loop, before a controller stand-in on this machine.

    python -m benchmarks.servo --model UR10e --seconds 600

The stand-in runs in a process of its own beside the servo process and this one: on an idle machine of two cores the
figures are the driver's, on a busy one they are the machine's. Exit code 1: a figure misses its target.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.servo_trace import RecordedJoints, TraceFigures, TraceMemory, compare
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport, MotionWatch
from toolee_robot.runtime.latency_monitor import CpuKeepalive, LatencyMonitor
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.station import ServoConfig, sim_station
from toolee_robot.types import ArmModel, Trajectory

AMPLITUDE: Final = 0.1  # [rad]
FREQUENCIES: Final = (0.20, 0.23, 0.29, 0.31, 0.37, 0.41)
"""[Hz] Of the joints; different, so that they are never all at rest at once."""
SAMPLE_PERIOD: Final = 0.004  # [s] of the trajectory
_PATIENT: Final = MotionWatch(tracking_error=1.0, data_cycles=500.0, overruns=500)
WARM_UP: Final = 2.0  # [s] before the first measurement of memory
_AROUND: Final = 60.0  # [s] of the stand-in before and after the motion, at most
_MONITOR_PAUSE: Final = 0.005  # [s] of the latency monitor, so that its own load stays small
_LARGEST_PERIOD_ERROR: Final = 1e-3  # [s], 99th percentile
_LARGEST_LAG_ERROR: Final = 1e-6  # [rad]


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
    """A motion without two equal commands: each joint follows a cosine of its own frequency back to its start."""
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


def measure_servo(arm: UnsupervisedUrArm, seconds: float) -> tuple[ServoFigures, MotionReport]:
    """Execute `wave` without stopping for late cycles, and measure the timing."""
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


@dataclass(frozen=True)
class Measured:
    """A run against the stand-in: the driver's figures, the joints', and stalls of the machine itself [s]."""

    servo: ServoFigures
    trace: TraceFigures
    stalls: int
    longest_stall: float

    @property
    def targets(self) -> dict[str, bool]:
        """Whether each target is met."""
        return {
            "period error p99 under 1 ms": self.servo.period_error_p99 < _LARGEST_PERIOD_ERROR,
            "no missed cycle unreported": self.trace.unreported == 0,
            "no drift": abs(self.servo.drift) < 0.5 / self.servo.rate,
            "tracking to 1e-6 rad plus the lag": self.trace.lag_error < _LARGEST_LAG_ERROR,
        }


def run(model: ArmModel, seconds: float, host: str) -> Measured:
    """Measure the driver before a stand-in of this model, at a loopback address of its own."""
    # Only the servo loop is measured: delays of this process must not end it.
    config = UrArmConfig(host, ServoConfig(heartbeat_timeout=1.0, hang_timeout=2.0), seconds + 10.0)
    with (
        closing(TraceMemory(round((seconds + _AROUND) / MODELS[model.value].period))) as memory,
        ControllerProcess(
            model=model.value,
            host=host,
            plant=partial(RecordedJoints, q=np.array(sim_station().scene.home), fd=memory.fd),
            inherit=(memory.fd,),
            realtime=True,
        ),
        UnsupervisedUrArm(config, replace(sim_station().arm, model=model)) as arm,
        CpuKeepalive(),
        LatencyMonitor(_MONITOR_PAUSE) as latency,
    ):
        latency.begin()
        figures, report = measure_servo(arm, seconds)
        return Measured(figures, compare(report, *memory.read(), arm.rate), latency.count, latency.longest)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.servo", description="Measure the driver's servo loop.")
    parser.add_argument("--model", type=ArmModel, choices=list(ArmModel), default=ArmModel.UR10)
    parser.add_argument("--seconds", type=float, default=30.0, help="duration of the motion, 5 or more")
    parser.add_argument("--host", default="127.0.0.29", help="a loopback address of its own for the stand-in")
    asked = parser.parse_args(arguments)
    measured = run(asked.model, asked.seconds, asked.host)
    servo, trace = measured.servo, measured.trace
    print(f"commands: {servo.cycles} at {servo.rate:.0f} Hz in {servo.seconds:.2f} s")
    errors = (servo.period_error_p50, servo.period_error_p99, servo.period_error_max)
    print("period error: p50 {:.3f}, p99 {:.3f}, max {:.3f} ms".format(*(1e3 * error for error in errors)))
    print(f"the machine itself: {measured.stalls} stalls over 5 ms, {measured.longest_stall * 1e3:.1f} ms at most")
    print(f"cycles sent late, by the driver: {servo.overruns}")
    print(f"at the robot: {trace.ticks} ticks ({trace.late_ticks} late, {trace.close_ticks} close to their command)")
    print(f"  {trace.held} without a command, {trace.skipped} overtaken, {trace.unreported} not explained")
    print(f"drift: {servo.drift * 1e3:+.3f} ms; lag: {trace.lag * 1e3:.2f} ms from sending to the joint")
    print(f"tracking, lag taken off: {trace.lag_error:.1e} rad at most, in {trace.followed:.1%} of the ticks")
    print(f"servo process: {servo.memory_growth / 1024:+.0f} KiB, {servo.cpu:.0%} of a core")
    print(f"  SCHED_FIFO {servo.fifo}, memory locked {servo.locked}")
    for name, met in measured.targets.items():
        print(f"{'met' if met else 'MISSED'}: {name}")
    return int(not all(measured.targets.values()))


if __name__ == "__main__":
    sys.exit(main())
