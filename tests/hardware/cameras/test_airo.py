"""The adapter of airo-camera-toolkit, on a camera of its interface; on its own base class where it is installed."""

from __future__ import annotations

import importlib
import time
from typing import Any, Self

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.errors import NoAnswerError, StaleDataError
from toolee_robot.hardware.cameras import StreamedCamera
from toolee_robot.hardware.cameras.airo import AiroStream
from toolee_robot.runtime.clock import HostClock

try:
    RGBDCamera: Any = importlib.import_module("airo_camera_toolkit.interfaces").RGBDCamera
except ImportError:
    RGBDCamera = object

RESOLUTION = (64, 48)


class SoftwareCamera(RGBDCamera):
    """A camera of the toolkit without hardware."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)
        self.frozen, self.broken = False, False
        self._rgb = np.zeros((48, 64, 3), np.uint8)
        self._depth = np.zeros((48, 64), np.float32)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.broken = True

    resolution, fps = RESOLUTION, 60.0

    def intrinsics_matrix(self) -> Any:
        return np.array([[60.0, 0.0, 31.0], [0.0, 61.0, 22.0], [0.0, 0.0, 1.0]])

    def grab_images(self) -> None:
        time.sleep(1 / 60)
        if self.broken:
            raise RuntimeError("Frame didn't arrive within 5000")
        if not self.frozen:
            self._rgb = self.rng.integers(0, 255, (48, 64, 3)).astype(np.uint8)
            self._depth = (0.6 + 0.2 * self.rng.random((48, 64))).astype(np.float32)
            self._depth[0] = np.nan

    def retrieve_rgb_image_as_int(self) -> Any:
        return self._rgb

    def retrieve_depth_map(self) -> Any:
        return self._depth

    def retrieve_rgb_image(self) -> Any:
        return self._rgb / 255

    def retrieve_depth_image(self) -> Any:
        return self._rgb

    def retrieve_colored_point_cloud(self) -> Any:
        raise NotImplementedError


@pytest.mark.realtime(light=True)
def test_it_gives_frames_and_its_failures_are_typed() -> None:
    camera = SoftwareCamera()
    with StreamedCamera(AiroStream(lambda: camera, "42"), HostClock()) as streamed:
        frame = streamed.read()
        assert streamed.profile.serial == "42"
        assert streamed.profile.model == "SoftwareCamera"
        assert (frame.intrinsics.fx, frame.intrinsics.fy, frame.intrinsics.cx) == (60.0, 61.0, 31.0)
        assert np.all(frame.depth[0] == 0)
        assert abs(np.median(frame.depth) - 0.7) < 0.02
        camera.frozen = True
        time.sleep(0.1)
        with raises(StaleDataError, "stale_data.camera_frozen"):
            streamed.read(max_age=0.3)
        camera.broken = True
        time.sleep(0.1)
        with raises(NoAnswerError, "no_answer.camera_unplugged"):
            streamed.read()


def test_a_camera_that_cannot_be_opened_is_typed() -> None:
    def fail() -> SoftwareCamera:
        raise ValueError("no device")

    with raises(NoAnswerError, "no_answer.camera_refuses"):
        AiroStream(fail, "42").open()
