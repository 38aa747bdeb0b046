"""What the doctor says of this computer."""

from __future__ import annotations

import os
import shutil
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest

from toolee_robot.doctor.machine import check_disk, check_processor, check_real_time, wake_up_lateness
from toolee_robot.findings import Level

_Usage = namedtuple("_Usage", "total used free")


def _cpus(folder: Path, *governors: str) -> Path:
    for i, governor in enumerate(governors):
        (folder / f"cpu{i}" / "cpufreq").mkdir(parents=True)
        (folder / f"cpu{i}" / "cpufreq" / "scaling_governor").write_text(governor + "\n")
    return folder


@pytest.mark.parametrize(
    ("governors", "level"),
    [
        ((), Level.OK),
        (("performance", "performance"), Level.OK),
        (("performance", "powersave"), Level.WARN),
    ],
)
def test_cores_that_sleep(tmp_path: Path, governors: tuple[str, ...], level: Level) -> None:
    found = {f.name: f for f in check_processor(_cpus(tmp_path, *governors))}
    assert found["frequency"].level is level
    assert ("powersave" in found["frequency"].message) == (level is Level.WARN)


@pytest.mark.parametrize(("n", "level"), [(1, Level.FAIL), (2, Level.WARN), (4, Level.OK)])
def test_cores(n: int, level: Level, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(n)))
    found = {f.name: f for f in check_processor(tmp_path)}
    assert (found["cores"].level, found["cores"].message) == (level, str(n))


@pytest.mark.parametrize(("free", "level"), [(100 << 30, Level.OK), (1 << 30, Level.WARN), (50 << 20, Level.FAIL)])
def test_room_for_recordings(free: int, level: Level, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: _Usage(200 << 30, 0, free))
    assert check_disk(tmp_path / "runs" / "later").level is level


def test_a_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    finding = check_disk(tmp_path / "runs")
    assert finding.level is Level.FAIL
    assert "--out" in finding.remedy


def test_real_time_warnings_say_what_to_do_and_leave_no_trace() -> None:
    before = os.sched_getscheduler(0)
    findings = list(check_real_time(125.0))
    assert [f.name for f in findings] == ["kernel", "priority", "memory", "schedule"]
    assert all(f.level is not Level.FAIL for f in findings), "a robot's rate can be kept without"
    assert all(bool(f.remedy) == (f.level is Level.WARN) for f in findings)
    assert os.sched_getscheduler(0) == before


def test_the_schedule_is_absolute() -> None:
    late = wake_up_lateness(200.0, 0.1)
    assert late.shape == (20,)
    assert np.all(late >= 0)
