"""`toolee bench-servo`: timing of the servo loop on this machine."""

from __future__ import annotations

import os
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.host_info import describe_machine
from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError
from toolee_robot.station import ArmLimits, SceneConfig, ServoConfig
from toolee_robot.types import ArmModel

if TYPE_CHECKING:
    from toolee_robot.cli.bench.servo_trace import TraceFigures
    from toolee_robot.devices.ur.servo_benchmark import ServoFigures

_PERIOD_TARGET_MS = 1.0
_AROUND = 60.0  # [s] of the stand-in before and after the motion, at most
_PAUSE = 0.005  # [s] of the latency monitor, so that its own load stays small


@dataclass(frozen=True)
class BenchServo:
    """Servo a controller stand-in on this machine and measure the driver's timing and tracking, memory and load.

    Example: toolee bench-servo --model UR10e --seconds 600 --json

    The stand-in runs in a process of its own beside the servo process and this one: on an idle machine of two cores the
    figures are the driver's, on a busy one they are the machine's. Exit code 1: a figure misses its target.
    """

    model: Literal["UR10", "UR10e"] = "UR10"
    """UR10: 125 Hz; UR10e: 500 Hz."""
    seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 30.0
    """Duration of the motion."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.29"
    """A loopback address of its own for the stand-in."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        if not 5.0 <= self.seconds <= 3600.0:
            raise UserError(f"--seconds {self.seconds:g}: give 5 to 3600", code="user.seconds")
        from toolee_robot.cli.bench.servo_trace import RecordedJoints, TraceMemory, compare
        from toolee_robot.devices.ur.config import UrArmConfig
        from toolee_robot.devices.ur.driver import UnsupervisedUrArm
        from toolee_robot.devices.ur.servo_benchmark import servo_benchmark
        from toolee_robot.runtime.cpu_keepalive import CpuKeepalive
        from toolee_robot.runtime.latency_monitor import LatencyMonitor
        from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
        from toolee_robot.sim_backend.ur_controller.robot.model import MODELS

        console = Console(stderr=self.json, highlight=False)
        # Only the servo loop is measured: delays of this process must not end it.
        config = UrArmConfig(self.host, ServoConfig(heartbeat_timeout=5.0, hang_timeout=5.0), self.seconds + 10.0)
        load = os.getloadavg()[0]
        with (
            closing(TraceMemory(round((self.seconds + _AROUND) / MODELS[self.model].period))) as trace_memory,
            ControllerProcess(
                model=self.model,
                host=self.host,
                plant=partial(RecordedJoints, q=np.array(SceneConfig().home), fd=trace_memory.fd),
                inherit=(trace_memory.fd,),
                realtime=True,
            ),
            UnsupervisedUrArm(config, ArmLimits(model=ArmModel(self.model))) as arm,
            CpuKeepalive(),
            LatencyMonitor(_PAUSE) as latency,
            console.status(f"servoing at {arm.rate:.0f} Hz for {self.seconds:g} s"),
        ):
            latency.begin()
            figures, report = servo_benchmark(arm, self.seconds)
            stalls = Stalls(latency.count, latency.longest)
            trace = compare(report, *trace_memory.read(), arm.rate)
        met = {
            "period error p99 under 1 ms": figures.period_error_p99 * 1e3 < _PERIOD_TARGET_MS,
            "no missed cycle unreported": trace.unreported == 0,
            "no drift": abs(figures.drift) < 0.5 / figures.rate,
            "tracking to 1e-6 rad plus the lag": trace.lag_error < 1e-6,
        }
        console.print(_table(figures, trace, stalls, met))
        if self.json:
            record = {
                "machine": asdict(describe_machine()),
                "load_before": load,
                "model": self.model,
                "servo": asdict(figures),
                "trace": asdict(trace),
                "stalls": asdict(stalls),
                "targets": met,
            }
            print(json_line(record), flush=True)
        return 0 if all(met.values()) else 1


@dataclass(frozen=True)
class Stalls:
    """Stalls of the machine itself, measured at a higher priority.

    Attributes:
        count: Number of stalls longer than 5 ms.
        longest: Longest stall [s].
    """

    count: int
    longest: float


def _table(servo: ServoFigures, trace: TraceFigures, machine: Stalls, met: dict[str, bool]) -> Table:
    table = Table(show_header=False)
    rows = {
        "commands": f"{servo.cycles} at {servo.rate:.0f} Hz in {servo.seconds:.2f} s",
        "period error": f"p50 {servo.period_error_p50 * 1e3:.3f}, p99 {servo.period_error_p99 * 1e3:.3f}, "
        f"max {servo.period_error_max * 1e3:.3f} ms",
        "the machine itself": f"stalled {machine.count} times for over 5 ms, {machine.longest * 1e3:.1f} ms at most",
        "late cycles, by the driver": f"{servo.overruns}",
        "at the robot": f"{trace.ticks} ticks ({trace.late_ticks} late themselves, {trace.close_ticks} close to their "
        f"command); {trace.held} without one, "
        f"{trace.skipped} commands overtaken; {trace.unreported} not explained",
        "drift": f"{servo.drift * 1e3:+.3f} ms",
        "lag": f"{trace.lag * 1e3:.2f} ms from sending to the joint",
        "tracking, lag taken off": f"{trace.lag_error:.1e} rad at most, in {trace.followed:.1%} of the ticks",
        "memory of the servo process": f"{servo.memory_growth / 1024:+.0f} KiB",
        "its load": f"{servo.cpu:.0%} of a core; SCHED_FIFO {'yes' if servo.fifo else 'no'}, "
        f"memory locked {'yes' if servo.locked else 'no'}",
    }
    for name, text in rows.items():
        table.add_row(name, text)
    for name, ok in met.items():
        table.add_row(name, "[green]met[/green]" if ok else "[red]missed[/red]")
    return table


COMMANDS = {"": BenchServo}
