"""A recording of a toy scene, for tests of what reads one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from toolee_robot.devices.cameras.recording import RECORDING, RecordingWriter
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
