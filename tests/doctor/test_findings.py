"""What the doctor says of exposure, the camera's least range, frames and this computer."""

from __future__ import annotations

import os
import shutil
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.devices.cameras.test_recording import toy_frames
from tests.examples import examples
from toolee_robot.devices.ur.probe import UrState
from toolee_robot.doctor.devices import check_exposure, check_range
from toolee_robot.doctor.frames import check_frames, parse_point
from toolee_robot.doctor.machine import (
    check_disk,
    check_force,
    check_processor,
    check_real_time,
    force_at_rest,
    wake_up_lateness,
)
from toolee_robot.findings import Finding, Level
from toolee_robot.frames import HALF_TURN, Array, transform
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.station import CameraDevice, sim_station
from toolee_robot.types import ArmModel


@pytest.mark.parametrize(("grey", "level"), [(120, Level.OK), (255, Level.WARN), (0, Level.WARN)])
def test_exposure(grey: int, level: Level) -> None:
    (finding,) = check_exposure(toy_frames(1, grey)[0], automatic=False)
    assert finding.level is level


def test_an_automatic_exposure_is_warned_of() -> None:
    assert [f.level for f in check_exposure(toy_frames(1)[0], automatic=True)] == [Level.OK, Level.WARN]
    assert [f.level for f in check_exposure(toy_frames(1)[0], automatic=None)] == [Level.OK]


@pytest.mark.parametrize(
    ("least", "level", "lost"),
    [
        (0.1, Level.OK, ""),
        (0.35, Level.WARN, "parts of a tool will lack depth"),
        (0.41, Level.WARN, "parts of a tool will lack depth"),
        (0.5, Level.FAIL, "no view nearer than 0.50 m would have a depth"),
        (0.53, Level.FAIL, "no view would have a depth"),
    ],
)
def test_the_least_range_is_compared_with_the_views(least: float, level: Level, lost: str) -> None:
    config = sim_station()
    with_device = replace(config, camera=replace(config.camera, device=CameraDevice("realsense", "1", least)))
    finding = check_range(with_device)
    assert finding.level is level
    assert lost in finding.remedy
    assert "views are 0.42 to 0.52 m away" in finding.message
    assert check_range(config).level is Level.WARN


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


CONFIG = sim_station()
HOME = np.array(CONFIG.scene.home)
OFFSET = np.array([0.0, 0.02, 0.15, 0.0, 0.0, 0.0])


def _state(q: Array, tcp_offset: Array) -> UrState:
    """What a robot reports at q."""
    X = DhParameters.of(CONFIG.arm.model).fk(q) @ transform(p=tcp_offset[:3])
    pose = np.concatenate([X[:3, 3], Rotation.from_matrix(X[:3, :3]).as_rotvec()])
    return UrState(q, np.zeros(6), pose, tcp_offset, None, 7, 1, 1, 3, 1, 1.0)


def _found(state: UrState, point: Array | None) -> dict[str, Finding]:
    return {finding.name: finding for finding in check_frames(state, CONFIG, point)}


@pytest.mark.parametrize("text", ["-691.4 -174.2 676.9", " -691.4, -174.2,  676.9 ", "-691.4; -174.2; 676.9"])
def test_a_point_is_read_as_it_is_typed(text: str) -> None:
    point = parse_point(text)
    assert point is not None
    assert point == pytest.approx([-0.6914, -0.1742, 0.6769])


@pytest.mark.parametrize("text", ["", "1 2", "1 2 3 4", "-691,4 -174,2 676,9", "1 2 nan", "1 2 inf", "x y z"])
def test_what_is_no_point_is_none(text: str) -> None:
    assert parse_point(text) is None


def test_the_tcp_is_told_in_both_frames() -> None:
    found = _found(_state(HOME, np.zeros(6)), None)
    x, y, z = DhParameters.of(CONFIG.arm.model).fk(HOME)[:3, 3] * 1e3
    assert f"pendant_base ({x:.1f}, {y:.1f}, {z:.1f})" in found["TCP place"].message
    assert f"base_link ({-x:.1f}, {-y:.1f}, {z:.1f})" in found["TCP place"].message
    assert found["jogged point"].level is Level.WARN


@examples(50)
@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6), st.lists(st.floats(-1e-3, 1e-3), min_size=3, max_size=3))
def test_a_reading_that_agrees_is_well_and_half_a_turn_is_named(change: list[float], rounding: list[float]) -> None:
    state = _state(HOME + change, OFFSET)
    tcp = state.tcp_pose[:3]
    if np.hypot(*tcp[:2]) < 0.05:
        return
    assert _found(state, tcp + rounding)["jogged point"].level is Level.OK
    turned = _found(state, HALF_TURN[:3, :3] @ tcp + rounding)["jogged point"]
    assert turned.level is Level.FAIL
    assert "half a turn" in turned.message


@pytest.mark.parametrize(
    ("of", "turn", "scale", "off", "cause"),
    [
        ("flange", False, 1.0, 0.0, "without the TCP"),
        ("flange", True, 1.0, 0.0, "half a turn about z, and the flange"),
        ("other model", False, 1.0, 0.0, "flange of a UR10e"),
        ("tcp", False, 1e-3, 0.0, "metres"),
        ("tcp", False, 1.0, 0.1, "no known mistake"),
    ],
)
def test_a_mismatch_is_named(of: str, turn: bool, scale: float, off: float, cause: str) -> None:
    state = _state(HOME, OFFSET)
    flange, other = (DhParameters.of(m).fk(HOME)[:3, 3] for m in (CONFIG.arm.model, ArmModel.UR10E))
    point = scale * {"flange": flange, "other model": other, "tcp": state.tcp_pose[:3]}[of] + np.array([0.0, off, 0.0])
    finding = _found(state, HALF_TURN[:3, :3] @ point if turn else point)["jogged point"]
    assert finding.level is Level.FAIL
    assert cause in finding.message
    assert finding.remedy


def _force(sd: float, offset: float, rate: float = 125.0) -> Array:
    return np.random.default_rng(0).normal(0.0, sd, (int(rate), 3)) + np.array([0.0, 0.0, offset])


@pytest.mark.parametrize(
    ("sd", "offset", "touch", "level"),
    [
        (0.1, 1.0, 8.0, Level.OK),
        (3.6, 7.0, 8.0, Level.OK),  # a CB3's, as a user measured it: slower
        (3.6, 7.0, 1.0, Level.WARN),
        (20.0, 7.0, 8.0, Level.WARN),
        (0.1, 30.0, 8.0, Level.FAIL),
        (0.0, 0.0, 8.0, Level.OK),
    ],
)
def test_the_force_of_a_touch_is_held_against_the_noise(sd: float, offset: float, touch: float, level: Level) -> None:
    config = replace(CONFIG, strike=replace(CONFIG.strike, touch_force=touch))
    force = force_at_rest(_force(sd, offset), 125.0)
    assert force.offset == pytest.approx(offset, abs=0.5 + 0.2 * sd)
    finding = check_force(force, config)
    assert finding.level is level, finding
    assert bool(finding.remedy) is (level is not Level.OK)
