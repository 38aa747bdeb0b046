"""What `toolee camera doctor` says of exposure, holes, the least range and the stream."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.devices.cameras.toy_recording import INTRINSICS, toy_frames, toy_recording
from toolee_robot.devices.cameras import StreamedCamera
from toolee_robot.devices.cameras.recording import RecordedStream
from toolee_robot.doctor.devices import check_exposure, check_holes, check_range, check_stream, sample_stream
from toolee_robot.findings import Level
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import CameraDevice, sim_station
from toolee_robot.types import RgbdFrame


@pytest.mark.parametrize(("grey", "level"), [(120, Level.OK), (255, Level.WARN), (0, Level.WARN)])
def test_exposure(grey: int, level: Level) -> None:
    (finding,) = check_exposure(toy_frames(2, grey), automatic=False)
    assert finding.level is level


def test_an_automatic_exposure_is_warned_of() -> None:
    assert [f.level for f in check_exposure(toy_frames(1), automatic=True)] == [Level.OK, Level.WARN]
    assert [f.level for f in check_exposure(toy_frames(1), automatic=None)] == [Level.OK]


@pytest.mark.parametrize(("share", "level"), [(0.1, Level.OK), (0.4, Level.WARN), (0.8, Level.FAIL)])
def test_holes_are_counted_on_the_tool_alone(share: float, level: Level) -> None:
    depth = np.zeros((72, 96), np.float32)
    tool = np.zeros((72, 96), bool)
    tool[20:30, 20:40] = True
    depth[20:30, 20:40] = 0.6
    depth[20:30, 20 : 20 + round(20 * share)] = np.nan
    frame = RgbdFrame(np.zeros((72, 96, 3), np.uint8), depth, INTRINSICS)
    finding = check_holes(frame, tool)
    assert finding.level is level
    assert f"{share:.0%} of the tool" in finding.message
    assert ("nothing nearer than camera.device.least_range" in finding.remedy) is (level is not Level.OK)
    assert check_holes(frame, None).level is Level.WARN


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


@pytest.mark.realtime(light=True)
def test_the_stream(tmp_path: Path) -> None:
    toy_recording(tmp_path / "r", 40)
    clock = HostClock()
    with StreamedCamera(RecordedStream(tmp_path / "r", clock), clock) as camera:
        sample = sample_stream(camera, clock, 0.8)
        found = {f.name: f for f in check_stream(sample, camera)}
    assert 15 < len(sample.frames) <= 26
    assert abs(sample.rate - 30) < 10
    assert found["gate"].level is Level.OK
