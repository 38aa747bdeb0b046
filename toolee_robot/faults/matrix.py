"""The fault matrix, measured row by row."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import get_args

from toolee_robot.errors import UserError
from toolee_robot.faults.measuring import Measurement
from toolee_robot.faults.record import FaultRow
from toolee_robot.faults.rigs.driver_rig import rig
from toolee_robot.faults.rigs.job_rig import Bench
from toolee_robot.faults.rigs.setting import Setting
from toolee_robot.faults.rows.arm import arm_rows
from toolee_robot.faults.rows.cameras import camera_rows, missing_cameras
from toolee_robot.faults.rows.collisions import collision_rows, restricted_rows
from toolee_robot.faults.rows.commands import command_rows
from toolee_robot.faults.rows.following import following_rows
from toolee_robot.faults.rows.hands import hand_rows
from toolee_robot.faults.rows.inputs import input_rows
from toolee_robot.faults.rows.job import job_rows
from toolee_robot.faults.rows.process import process_rows
from toolee_robot.faults.rows.released_stops import released_rows
from toolee_robot.faults.rows.start import calibration_rows, start_rows
from toolee_robot.faults.rows.switch import switch_rows
from toolee_robot.runtime.cpu_keepalive import CpuKeepalive
from toolee_robot.runtime.latency_monitor import LatencyMonitor
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.types import ArmModel


class Part(StrEnum):
    """Parts of the matrix.

    ARM: driver and supervisor on the controller stand-in. JOB: the task on the simulated station. HAND, CAMERA: the
    same with the drivers of hands and cameras on emulated ones.
    """

    ALL = "all"
    ARM = "arm"
    JOB = "job"
    HAND = "hand"
    CAMERA = "camera"


@dataclass(frozen=True)
class MatrixOptions:
    """Options of a run of the matrix.

    Attributes:
        host: Loopback address of the stand-ins.
        models: Models of the arm under which the arm's faults are injected.
        profiles: Profiles of the controller under which they are, each on every model.
        part: Part of the matrix.
        fault: Only rows whose fault contains this text; empty for all.
    """

    host: str = "127.0.0.70"
    models: tuple[ArmModel, ...] = (ArmModel.UR10, ArmModel.UR10E)
    profiles: tuple[ProfileName, ...] = get_args(ProfileName)
    part: Part = Part.ALL
    fault: str = ""


def run_matrix(options: MatrixOptions) -> Iterator[FaultRow]:
    """Measure the matrix and yield its rows in the order of measurement.

    Raises:
        UserError: No row's fault contains the text that is asked for.
    """
    found = False
    with CpuKeepalive(), LatencyMonitor() as machine:
        for measurement in _measurements(options):
            if options.fault in measurement.fault:
                found = True
                yield measurement.row(machine)
    if not found:
        raise UserError(f"no row's fault contains {options.fault!r}", code="user.no_fault_row")


def left_out(options: MatrixOptions) -> list[str]:
    """What has no rows in a run of the matrix, since this machine lacks what its driver needs.

    Args:
        options: Options of the run.

    Returns:
        One sentence each.
    """
    return missing_cameras() if options.part in (Part.ALL, Part.CAMERA) else []


def _measurements(options: MatrixOptions) -> Iterator[Measurement]:
    if options.part in (Part.ALL, Part.ARM):
        for profile in options.profiles:
            for model in options.models:
                yield from _arm_part(Setting(model, options.host, profile))
    if options.part is not Part.ARM:
        yield from _job_part(options.part)


def _arm_part(setting: Setting) -> Iterator[Measurement]:
    yield from start_rows(setting)
    with rig(setting) as arm_rig:
        yield from arm_rows(arm_rig)
        yield from command_rows(arm_rig)
        yield from released_rows(arm_rig)
        yield from following_rows(arm_rig)
        yield from input_rows(arm_rig)
        yield from switch_rows(arm_rig)
        yield from collision_rows(arm_rig)
    yield from restricted_rows(setting)
    yield from process_rows(setting)


def _job_part(part: Part) -> Iterator[Measurement]:
    bench = Bench()
    with bench.sim:
        if part in (Part.ALL, Part.JOB):
            yield from calibration_rows(bench)
            yield from job_rows(bench)
        if part in (Part.ALL, Part.HAND):
            yield from hand_rows(bench)
        if part in (Part.ALL, Part.CAMERA):
            yield from camera_rows(bench)
