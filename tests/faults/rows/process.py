"""Faults of the task's own process (Ctrl-C, SIGKILL, a stall), after which the servo process must stop the arm."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.arm import AT_REST, HEARTBEAT
from tests.rigs.driver_rig import BEFORE_CONTACT, OFF_PATH, SETTLE_TIME, START_TIME
from tests.rigs.joints_path import MOVING, stop_after
from tests.rigs.setting import Setting
from tests.rigs.strikes import plan_swing
from toolee_robot.errors import DeviceError, MotionFaultError
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess

HEARTBEAT_PERIOD = 0.02  # [s] between two heartbeats


@dataclass(frozen=True)
class TaskFault:
    """A fault of the task's process.

    Attributes:
        signal: Signal that is sent to the process.
        notice: Largest time until the servo process detects it [s].
    """

    fault: str
    signal: signal.Signals
    notice: float


TASK_FAULTS = (
    # The interpreter handles a signal between two bytecodes.
    TaskFault("task gets Ctrl-C", signal.SIGINT, 0.02),
    # The kernel reports it at once: `OwnerWatch`.
    TaskFault("task killed (SIGKILL)", signal.SIGKILL, 0.002),
    TaskFault("task stalls (SIGSTOP)", signal.SIGSTOP, HEARTBEAT + HEARTBEAT_PERIOD),
)


def process_rows(setting: Setting) -> Iterator[Measurement]:
    """Yield each fault in mid-swing and at rest, each with its own task and stand-in."""
    for fault in TASK_FAULTS:
        for phase in (Phase.SWING, Phase.REST):
            run = partial(_row, fault, phase, setting)
            yield Measurement(11, fault.fault, phase, setting.name, "brakes on the path", run)


def _row(fault: TaskFault, phase: Phase, setting: Setting) -> FaultRow:
    swing, name = plan_swing(setting.model), setting.name
    strike, limits = swing.plan.strike, swing.config.arm
    task_arguments = (setting.host, setting.model.value, setting.profile)
    with setting.start(strike.q[0]) as controller:
        task = subprocess.Popen(
            [sys.executable, "-m", "tests.rigs.swinging_task", *task_arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        try:
            assert task.stdin is not None
            assert task.stdout is not None
            if task.stdout.readline().strip() != "ready":
                raise DeviceError("the task did not get ready")
            before = controller.state()["tick"]
            if phase is Phase.SWING:
                task.stdin.write("go\n")
                task.stdin.flush()
                _await_motion(controller)
                time.sleep(swing.plan.contact_time - BEFORE_CONTACT - setting.lag)
            at = time.monotonic()
            task.send_signal(fault.signal)
            time.sleep(1.0 + SETTLE_TIME)
            trace = controller.trace(before)
            program_ended = controller.state()["program_state"] != "PLAYING"
            said = _continued(task) if fault.signal is signal.SIGSTOP and phase is Phase.SWING else ""
        finally:
            task.kill()
            task.wait()
    if phase is Phase.REST:
        moved = float(np.ptp(trace.q_target, axis=0).max())
        wrong = [] if moved < AT_REST else [f"the arm moved by {moved:.4f} rad"]
        got = "stands still, program ended" if program_ended else "stands still"
        return FaultRow(
            11, fault.fault, phase, name, "stands still", got, program_ended, not wrong, "; ".join(wrong),
            off_path=moved,
        )  # fmt: skip
    stop = stop_after(trace, strike, at)
    allowed = fault.notice + setting.braking(strike, stop.path_time, fault.notice, limits) + 2 * setting.period
    wrong = []
    latched = program_ended or said == MotionFaultError.__name__
    if not latched:
        wrong.append("the robot's program runs on, and the task was told nothing")
    if stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if stop.off_path > OFF_PATH + setting.rounding(strike):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    got = "at rest, program ended" if program_ended else f"at rest, then {said}"
    return FaultRow(
        11, fault.fault, phase, name, "brakes on the path", got, latched, not wrong, "; ".join(wrong),
        stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip


def _continued(task: subprocess.Popen[str]) -> str:
    """Continue the task and read the outcome of its motion."""
    assert task.stdout is not None
    task.send_signal(signal.SIGCONT)
    return task.stdout.readline().strip()


def _await_motion(controller: ControllerProcess) -> None:
    began = time.monotonic()
    while np.abs(controller.state()["qd"]).max() < MOVING:
        if time.monotonic() > began + START_TIME:
            raise DeviceError("the task does not swing")
        time.sleep(1e-3)
