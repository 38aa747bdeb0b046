"""Faults of each camera, through its own driver, under the job.

The fault happens to the SDK's software device, is in what its playback device plays, or happens to a camera of the
SDK's interface; the driver must tell it by a typed error, and the job must not strike.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.job import job_row
from tests.faults.rows.job_fault import IN_STRIKE, JobFault, Scene
from tests.faults.rows.start import OURS, calibration_row
from tests.rigs.camera_rig import CAMERAS, OTHER_SERIAL, SERIAL, CameraEvent, CameraKind, DriverCamera
from tests.rigs.job_rig import CONFIG, Bench
from toolee_robot.errors import TooleeError
from toolee_robot.station import SIMULATED, CalibrationConfig, CameraConfig
from toolee_robot.tasks.common.outcome import Outcome, Stage

NO_STRIKE = "no strike, arm stands, grip kept"
NO_NEXT = "no further strike, arm stands, grip kept"
LOOKS = "looks again, then gives up, no strike"
REFUSES = "the camera is not opened"
NOTHING_MOVES = "refuses to start, nothing moves"
NOTICED = 1.3
"""Time from an event until the job goes on [s]: a driver takes 1.2 s to notice a camera that is gone."""
SEEN = 0.1
"""The same of what is seen in every frame [s]."""


@dataclass(frozen=True)
class CameraFault:
    """A fault of a camera, and the required reaction."""

    number: int
    event: CameraEvent
    code: str
    settles: float = SEEN


FAULTS = (
    CameraFault(20, CameraEvent.UNPLUGGED, "no_answer.camera_unplugged", NOTICED),
    CameraFault(22, CameraEvent.SILENT, "stale_data.camera"),
    CameraFault(22, CameraEvent.FROZEN, "stale_data.camera_frozen"),
    CameraFault(22, CameraEvent.REPEATED, "stale_data.camera_repeats"),
    CameraFault(22, CameraEvent.LATE, "stale_data.camera_late"),
    CameraFault(23, CameraEvent.BLIND, ""),
    CameraFault(23, CameraEvent.UNIT, "device.camera_depth_unit"),
)
"""The faults of the frames."""

CALIBRATIONS = (
    ("no calibration", None, "not calibrated"),
    ("calibration of another camera", replace(OURS, camera_serial=OTHER_SERIAL), f"camera {OTHER_SERIAL!r}"),
    ("stale calibration", replace(OURS, camera_serial=SERIAL, measured_on="2020-01-01", valid_days=30.0), "days old"),
    ("calibration of a rehearsal", replace(OURS, camera_serial=SIMULATED), "simulated or rehearsed"),
)
"""Calibrations with which a job must not begin before the camera that is connected: name, calibration, words."""


def camera_rows(bench: Bench) -> Iterator[Measurement]:
    """Yield each fault of each camera whose SDK is installed."""
    for kind in CAMERAS:
        if kind.missing:
            continue
        run = partial(other_camera_row, kind)
        yield Measurement(24, "another camera is connected", Phase.START, kind.label, REFUSES, run)
        run = partial(other_lens_row, kind)
        yield Measurement(24, "another lens than the station file's", Phase.START, kind.label, REFUSES, run)
        for name, calibration, words in CALIBRATIONS:
            run = partial(camera_calibration_row, name, calibration, words, kind, bench)
            yield Measurement(24, name, Phase.START, _on(kind), NOTHING_MOVES, run)
        for fault in FAULTS:
            if fault.event in kind.lacks:
                continue
            for phase in (Phase.REST, Phase.SWING) if fault.event in kind.at_once else (Phase.REST,):
                run = partial(camera_row, fault, phase, kind, bench)
                yield Measurement(fault.number, fault.event, phase, _on(kind), _expected(fault, phase), run)


def missing_cameras() -> list[str]:
    """The cameras that have no rows because what their driver needs is not installed, and why."""
    return [f"{kind.label}: {why}" for kind in CAMERAS if (why := kind.missing)]


def camera_row(fault: CameraFault, phase: Phase, kind: CameraKind, bench: Bench) -> FaultRow:
    """Measure one fault of the frames in one job."""
    bench.reset()
    with DriverCamera(bench.sim, kind, fault.event) as camera:
        row = job_row(_job_fault(fault, phase, kind, camera), bench, camera=camera)
    return replace(row, on=_on(kind), got=f"{row.got}, {code}" if (code := _code(fault, kind)) else row.got)


def camera_calibration_row(
    name: str, calibration: CalibrationConfig | None, message: str, kind: CameraKind, bench: Bench
) -> FaultRow:
    """Measure a job with a calibration that does not hold for the connected camera."""
    with DriverCamera(bench.sim, kind) as camera:
        row = calibration_row(bench, name, calibration, message, camera)
    return replace(row, on=_on(kind))


def other_camera_row(kind: CameraKind) -> FaultRow:
    """Measure the opening of a camera where another one is connected."""
    return _opening_row("another camera is connected", kind, kind.other, connected=OTHER_SERIAL)


def other_lens_row(kind: CameraKind) -> FaultRow:
    """Measure the opening of a camera that has another focal length than the station file says."""
    config = replace(kind.config, fx=1.05 * kind.config.fx)
    return _opening_row("another lens than the station file's", kind, "not_ready.camera_intrinsics", config=config)


def _expected(fault: CameraFault, phase: Phase) -> str:
    """The required reaction, in words."""
    if not fault.code:
        return LOOKS
    return NO_NEXT if phase is Phase.SWING else NO_STRIKE


def _on(kind: CameraKind) -> str:
    """Name of the rows' column."""
    return f"{kind.label}, simulated {CONFIG.arm.model}"


def _opening_row(
    name: str, kind: CameraKind, code: str, *, connected: str = SERIAL, config: CameraConfig | None = None
) -> FaultRow:
    got, why = "opened", f"{code} expected, the camera was opened"
    try:
        with DriverCamera(None, kind, connected=connected, config=config):
            pass
    except TooleeError as error:
        got, why = error.code, "" if error.code == code else f"{code} expected, got {error.code}: {error}"
    return FaultRow(24, name, Phase.START, kind.label, REFUSES, got, False, not why, why)


def _code(fault: CameraFault, kind: CameraKind) -> str:
    return kind.codes.get(fault.event, fault.code)


def _job_fault(fault: CameraFault, phase: Phase, kind: CameraKind, camera: DriverCamera) -> JobFault:
    def settle() -> None:
        time.sleep(fault.settles)

    def inject(scene: Scene) -> None:
        camera.device.happen()
        if phase is Phase.SWING:
            scene.log.after["to a view"] = settle  # in the swing nothing may wait
        else:
            settle()

    swings, blind = phase is Phase.SWING, not fault.code
    return JobFault(
        fault.number, fault.event, phase, _expected(fault, phase), inject, IN_STRIKE if swings else Stage.VIEW,
        Outcome.POSE_UNKNOWN if blind else Outcome.DEVICE_FAULT, "lies where a held hammer cannot" if blind else "",
        int(swings), "home" if blind else "to a view", looks_again=blind, sees=True, max_strikes=2,
        code=_code(fault, kind),
    )  # fmt: skip
