"""Faults of the cameras through their own drivers are handled, and a row whose guard is taken away is not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.faults.record import FaultRow, Phase
from tests.faults.rows import cameras
from tests.faults.rows.cameras import (
    CALIBRATIONS,
    FAULTS,
    CameraFault,
    camera_calibration_row,
    camera_row,
    camera_rows,
    other_camera_row,
    other_lens_row,
)
from tests.rigs.camera_rig import CAMERAS, CameraEvent, CameraKind, DriverCamera
from tests.rigs.job_rig import Bench
from toolee_robot.devices.cameras.stream import FrameGate, RawImages, Refusal
from toolee_robot.errors import UserError
from toolee_robot.hal import Station

pytestmark = pytest.mark.realtime

REALSENSE, ORBBEC, RECORDED = CAMERAS
_QUICK = {
    (CameraEvent.FROZEN, REALSENSE.label),
    (CameraEvent.LATE, ORBBEC.label),
    (CameraEvent.UNPLUGGED, REALSENSE.label),
}
"""What is measured in every run, at rest: nightly all of them."""


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    bench = Bench()
    with bench.sim:
        yield bench


def _installed(kind: CameraKind) -> CameraKind:
    if kind.missing:
        pytest.skip(kind.missing)
    return kind


def _fault(event: CameraEvent) -> CameraFault:
    (fault,) = (f for f in FAULTS if f.event is event)
    return fault


def _of(kind: CameraKind) -> str:
    return kind.label.split()[0].strip(",")


KINDS = pytest.mark.parametrize("kind", CAMERAS, ids=_of)


def test_every_fault_of_every_camera_is_there_or_it_is_said_why_not(bench: Bench) -> None:
    rows = [(row.number, row.fault, row.phase, row.on) for row in camera_rows(bench)]
    assert len(set(rows)) == len(rows)
    for kind in CAMERAS:
        mine = [row for row in rows if row[3].startswith(kind.label)]
        if kind.missing:
            assert not mine
            continue
        assert {row[0] for row in mine} >= {22, 23, 24}
        there = {row[1] for row in mine}
        assert there.isdisjoint(kind.lacks)
        assert there | set(kind.lacks) >= set(CameraEvent) - {CameraEvent.NOTHING}
        assert all(kind.lacks.values())
        assert {row[1] for row in mine if row[2] is Phase.SWING} == set(kind.at_once)


@pytest.mark.parametrize(
    ("kind", "fault", "phase"),
    [
        pytest.param(
            kind,
            fault,
            phase,
            id=f"{_of(kind)}-{fault.event}-{phase}",
            marks=() if (fault.event, kind.label) in _QUICK and phase is Phase.REST else pytest.mark.nightly,
        )
        for kind in CAMERAS
        for fault in FAULTS
        if fault.event not in kind.lacks
        for phase in (Phase.REST, Phase.SWING)
        if phase is Phase.REST or fault.event in kind.at_once
    ],
)
def test_a_fault_is_handled(bench: Bench, kind: CameraKind, fault: CameraFault, phase: Phase) -> None:
    row = camera_row(fault, phase, _installed(kind), bench)
    assert row.handled, row.why
    assert (row.number, row.fault, row.phase, row.on) == (
        fault.number,
        fault.event,
        phase,
        f"{kind.label}, simulated UR10",
    )
    assert (fault.code == "") == (row.got == "pose unknown")


@KINDS
def test_another_camera_and_another_lens_are_not_opened(kind: CameraKind) -> None:
    _installed(kind)
    for row in (other_lens_row(kind), other_camera_row(kind)):
        assert row.handled, row.why


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.nightly if k else ()) for k, kind in enumerate(CAMERAS)], ids=_of
)
@pytest.mark.parametrize(("name", "calibration", "words"), CALIBRATIONS, ids=[name for name, *_ in CALIBRATIONS])
def test_a_calibration_that_does_not_hold(
    bench: Bench, kind: CameraKind, name: str, calibration: None, words: str
) -> None:
    row = camera_calibration_row(name, calibration, words, _installed(kind), bench)
    assert row.handled, row.why


def test_a_camera_whose_sdk_is_missing_has_no_rows_and_is_named(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def sdk() -> None:
        raise UserError("install it", code="user.missing_package")

    gone = replace(REALSENSE, sdk=sdk)
    monkeypatch.setattr(cameras, "CAMERAS", (gone, RECORDED))
    assert {row.on.split(",")[0] for row in camera_rows(bench)} == {"recorded frames"}
    assert cameras.missing_cameras() == [f"{gone.label}: install it"]


# -- the matrix can fail -------------------------------------------------------------------------------------------


def _not_handled(row: FaultRow, why: str) -> None:
    assert not row.handled
    assert why in row.why


@pytest.mark.nightly  # a whole job
def test_without_the_gate_of_the_frames(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def admit(_: FrameGate, __: RawImages, arrival: float) -> float | Refusal:
        return arrival

    monkeypatch.setattr(FrameGate, "admit", admit)
    _not_handled(camera_row(_fault(CameraEvent.FROZEN), Phase.REST, RECORDED, bench), "stale_data.camera_frozen")


# -- the rig -------------------------------------------------------------------------------------------------------


@KINDS
def test_a_drivers_frames_are_of_the_stations_time(bench: Bench, kind: CameraKind) -> None:
    bench.reset()
    with DriverCamera(bench.sim, _installed(kind)) as camera:
        bench.camera = camera
        station: Station = bench.station
        asked = station.clock.now()
        frame = station.camera.read()
        assert asked <= frame.stamp <= station.clock.now() + 1e-3
        assert np.mean(frame.depth > 0) > 0.3
        assert frame.intrinsics == camera.intrinsics
