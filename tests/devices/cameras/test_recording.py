"""A recording of a toy scene, for tests of what reads one."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.devices.cameras import StreamedCamera
from toolee_robot.devices.cameras.recording import (
    DEPTH_UNIT,
    RECORDING,
    RecordedStream,
    RecordingWriter,
    open_recording,
)
from toolee_robot.devices.cameras.stream import FrameGate
from toolee_robot.errors import StaleDataError, UserError
from toolee_robot.perception.io import bop_images
from toolee_robot.runtime.clock import HostClock
from toolee_robot.types import CameraIntrinsics, RgbdFrame

INTRINSICS = CameraIntrinsics(90.25, 91.5, 47.125, 35.0, 96, 72)
SERIAL = "77"


def toy_frames(count: int, level: int = 120) -> list[RgbdFrame]:
    """Frames at 30 Hz: noise about a grey level, depth 0.5 to 0.8 m, a corner without."""
    rng = np.random.default_rng(3)
    frames = []
    for n in range(count):
        rgb = np.clip(level + rng.integers(-9, 10, (72, 96, 3)), 0, 255).astype(np.uint8)
        depth = (0.5 + 0.3 * rng.random((72, 96))).astype(np.float32)
        depth[:18, :24] = np.nan
        frames.append(RgbdFrame(rgb, depth, INTRINSICS, 5000.0 + n / 30))
    return frames


def toy_recording(folder: Path, count: int = 60, level: int = 120) -> list[RgbdFrame]:
    """Write a recording; returns its frames."""
    frames = toy_frames(count, level)
    with RecordingWriter(folder, "toy", SERIAL, 30.0, INTRINSICS) as writer:
        for frame in frames:
            writer.add(frame)
    return frames


def say_undistorted(folder: Path, undistorted: bool | None) -> None:
    """Let a recording say whether its images are undistorted; None: not at all, as one of an earlier version."""
    about = {n: v for n, v in json.loads((folder / RECORDING).read_text()).items() if n != "undistorted"}
    (folder / RECORDING).write_text(json.dumps(about if undistorted is None else {**about, "undistorted": undistorted}))


def test_frames_are_read_as_they_were_written(tmp_path: Path) -> None:
    frames = toy_recording(tmp_path / "r", 3)
    recording = open_recording(tmp_path / "r")
    assert recording.intrinsics == INTRINSICS
    assert (recording.serial, recording.model, recording.fps) == (SERIAL, "toy", 30.0)
    assert recording.stamps == tuple(frame.stamp for frame in frames)
    for n, frame in enumerate(frames):
        rgb, depth = recording.read(n)
        np.testing.assert_array_equal(rgb, frame.rgb)
        np.testing.assert_allclose(depth * recording.depth_scale, np.nan_to_num(frame.depth), atol=0.51 * DEPTH_UNIT)
    images = bop_images(tmp_path / "r")
    np.testing.assert_allclose(images[1].read().depth, np.nan_to_num(frames[1].depth), atol=0.51 * DEPTH_UNIT)
    assert images[1].read().intrinsics == INTRINSICS


def test_a_recording_that_is_interrupted_is_kept(tmp_path: Path) -> None:
    def record() -> None:
        with RecordingWriter(tmp_path / "r", "toy", SERIAL, 30.0, INTRINSICS) as writer:
            writer.add(toy_frames(1)[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert len(open_recording(tmp_path / "r").stamps) == 1


def test_a_recording_that_is_killed_can_be_read(tmp_path: Path) -> None:
    """Up to a second is lost, and what it lost is in nobody's way."""
    writer = RecordingWriter(tmp_path / "r", "toy", SERIAL, 30.0, INTRINSICS).__enter__()
    for frame in toy_frames(33):
        writer.add(frame)
    assert len(open_recording(tmp_path / "r").stamps) == 31
    assert [image.im_id for image in bop_images(tmp_path / "r")] == list(range(31))


def test_a_folder_is_not_written_over(tmp_path: Path) -> None:
    with raises(UserError, says="name a new folder"), RecordingWriter(tmp_path, "toy", SERIAL, 30.0, INTRINSICS):
        pass


@pytest.mark.parametrize(
    "damage", ["no folder", "no json", "no frames", "no stamp", "no image", "other size", "a word"]
)
def test_what_is_no_recording_is_refused(tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "r"
    toy_recording(folder, 2)
    cameras = folder / "scene_camera.json"
    if damage == "no folder":
        folder = tmp_path / "other"
    elif damage == "no json":
        cameras.write_text("{")
    elif damage == "no frames":
        cameras.write_text("{}")
    elif damage == "no stamp":
        entries = json.loads(cameras.read_text())
        del entries["1"]["stamp"]
        cameras.write_text(json.dumps(entries))
    elif damage == "no image":
        (folder / "depth" / "000001.png").unlink()
    elif damage == "a word":
        camera = json.loads((folder / "recording.json").read_text())
        (folder / "recording.json").write_text(json.dumps(camera | {"undistorted": "no"}))
    else:
        camera = json.loads((folder / "recording.json").read_text())
        (folder / "recording.json").write_text(json.dumps(camera | {"width": 95}))
    with raises(UserError, says=str(folder)):
        open_recording(folder).read(1)


@pytest.mark.nightly
@pytest.mark.realtime(light=True)
def test_it_is_played_once_as_fast_as_it_was_recorded(tmp_path: Path) -> None:
    frames = toy_recording(tmp_path / "r", 20)
    clock = HostClock()
    with StreamedCamera(RecordedStream(tmp_path / "r", clock), clock) as camera:
        begin, seen, stamp = clock.now(), [], 0.0
        with raises(StaleDataError, "stale_data.camera"):
            while True:
                frame = camera.newer(stamp, max_age=0.3)
                stamp = frame.stamp
                seen.append(frame)
        assert len(seen) >= 15, "a few may be lost to load, no more"
        assert seen[-1].stamp - begin > 0.5
    np.testing.assert_array_equal(seen[-1].rgb, frames[-1].rgb)


@dataclass(frozen=True)
class _Clock(HostClock):
    """It stands still but for those who wait for it."""

    time: list[float] = field(default_factory=lambda: [7.0])

    def now(self) -> float:
        return self.time[0]

    def sleep(self, duration: float) -> None:
        self.time[0] += max(duration, 0.0)


def test_its_stamps_are_the_recorded_ones(tmp_path: Path) -> None:
    recorded, clock = [frame.stamp for frame in toy_recording(tmp_path / "r", 20)], _Clock()
    stream = RecordedStream(tmp_path / "r", clock)
    gate, stamps = FrameGate(stream.open()), []
    for _ in recorded:
        images = stream.fetch(1.0)
        assert images is not None
        stamps.append(gate.admit(images, clock.now()))
    np.testing.assert_allclose(np.diff(np.array(stamps, float)), np.diff(recorded), atol=1e-9)
