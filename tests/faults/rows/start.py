"""Faults that must prevent the start: a robot that is not as configured, an invalid calibration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.job import ON
from tests.rigs.camera_rig import DriverCamera
from tests.rigs.job_rig import CONFIG, Bench, Log, at_rest, grip_kept
from tests.rigs.setting import Setting
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import NotReadyError
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import SIMULATED, CalibrationConfig, sim_station
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.types import ArmModel, Payload

HAND = Payload(4.2, np.array([0.0, 0.0, 0.12]))  # the correct payload of the installation
REFUSES = "refuses to start, nothing moves"


@dataclass(frozen=True)
class StartFault:
    """A fault that must prevent the start."""

    fault: str
    hook: str
    arguments: Mapping[str, Any]
    message: str
    remedy: str
    e_series: bool = False


START_FAULTS = (
    StartFault("wrong payload", "payload", {"mass": 1.5, "cog": [0.0, 0.0, 0.12]}, "1.50 kg", "payload page"),
    StartFault("wrong centre of gravity", "payload", {"mass": 4.2, "cog": [0, 0, 0]}, "(0, 0, 0) mm", "payload page"),
    StartFault("wrong TCP", "tcp", {"pose": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]}, "100.0) mm", "TCP page"),
    StartFault("wrong robot model", "model", {"name": "UR5"}, "UR5", "arm.model"),
    StartFault("another arm's kinematics", "kinematics", {"a": [0, 0.05, 0, 0, 0, 0], "d": [0] * 6}, "mm off", "check"),
    StartFault("unknown controller version", "version", {"version": [10, 7, 0, 1]}, "10.7.0.1", "PolyScope"),
    StartFault("speed slider at half", "speed_slider", {"fraction": 0.5}, "50%", "slider"),
    StartFault("local control", "remote", {"remote": False}, "local control", "remote control", e_series=True),
    StartFault("protective stop", "protective_stop", {}, "protective stop", "release"),
    StartFault("emergency stop", "emergency_stop", {}, "emergency stop", "release"),
)  # fmt: skip


def start_rows(setting: Setting, controller: ControllerProcess) -> Iterator[Measurement]:
    """Yield each fault, injected before the driver connects."""
    for fault in START_FAULTS:
        if setting.model is ArmModel.UR10E or not fault.e_series:
            run = partial(start_row, fault, setting, controller)
            yield Measurement(14, fault.fault, Phase.START, setting.name, REFUSES, run)


def start_row(fault: StartFault, setting: Setting, controller: ControllerProcess) -> FaultRow:
    """Measure one fault."""
    _as_it_should_be(controller)
    controller.fault(fault.hook, **fault.arguments)
    config = replace(UrArmConfig(controller.host), payload=HAND, tcp=(0.0,) * 6)
    before = controller.state()
    wrong, got = [], "started"
    try:
        with UnsupervisedUrArm(config, replace(sim_station().arm, model=setting.model)):
            pass
        wrong.append("the driver started")
    except NotReadyError as error:
        got = "NotReadyError"
        wrong += [
            f"the refusal does not say {what!r}: {error}"
            for what in (fault.message, fault.remedy)
            if what not in str(error)
        ]
    after = controller.state()
    moved = float(np.abs(np.subtract(after["q_target"], before["q_target"])).max())
    if moved > 0.0:
        wrong.append(f"the arm moved by {moved:.4f} rad")
    if after["uploads"] != before["uploads"]:
        wrong.append("a program was sent to the robot")
    return FaultRow(
        14, fault.fault, Phase.START, setting.name, REFUSES, got, False, not wrong, "; ".join(wrong), off_path=moved
    )


def _as_it_should_be(controller: ControllerProcess) -> None:
    controller.fault("reset")
    controller.fault("payload", mass=HAND.mass, cog=HAND.center_of_mass.tolist())
    controller.fault("tcp", pose=[0.0] * 6)


OURS = CalibrationConfig("2026-01-01", SIMULATED, SIMULATED, 0.001, valid_days=None)
CALIBRATIONS = (
    ("no calibration", None, "not calibrated"),
    ("calibration of another robot", replace(OURS, robot_serial="20235012345"), "robot '20235012345'"),
    ("calibration of another camera", replace(OURS, camera_serial="F1370001"), "camera 'F1370001'"),
    ("stale calibration", replace(OURS, measured_on="2020-01-01", valid_days=30.0), "days old"),
    ("calibration with a large residual", replace(OURS, residual=0.02), "residual"),
)


def calibration_rows(bench: Bench) -> Iterator[Measurement]:
    """Yield each calibration that must prevent the start of a job."""
    for name, calibration, message in CALIBRATIONS:
        run = partial(calibration_row, bench, name, calibration, message)
        yield Measurement(24, name, Phase.START, ON, REFUSES, run)


def calibration_row(
    bench: Bench, name: str, calibration: CalibrationConfig | None, message: str, camera: DriverCamera | None = None
) -> FaultRow:
    """Measure a job with an invalid calibration."""
    bench.reset()
    if camera is not None:
        bench.camera, bench.camera_serial = camera, camera.serial
    log, before = Log(), bench.sim.world.robot.arm_state()[0]
    result = bench.blind_task(log, replace(CONFIG, calibration=calibration)).run()
    moved = float(np.abs(bench.sim.world.robot.arm_state()[0] - before).max())
    wrong = []
    if result.outcome is not Outcome.NOT_READY:
        wrong.append(f"{Outcome.NOT_READY} expected, got {result.outcome}")
    if message not in result.reason:
        wrong.append(f"the reason does not say {message!r}: {result.reason}")
    if log.motions or bench.people.asked or bench.hand.opened:
        wrong.append(f"it went on: {log.motions}, {bench.people.asked}")
    if moved > 1e-3 or not at_rest(bench.sim) or not grip_kept(bench.sim):
        wrong.append("the arm does not stand where it stood, or let go")
    return FaultRow(
        24, name, Phase.START, ON, REFUSES, result.outcome.replace("_", " "), False, not wrong, "; ".join(wrong),
        off_path=moved,
    )  # fmt: skip
