"""The adapter of airo-camera-toolkit, on a camera of its interface; on its own base class where it is installed."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.devices.cameras.airo_cameras import OnTheirBase
from tests.errors import raises
from tests.rigs.software_airo import SoftwareAiroCamera
from toolee_robot.devices.cameras import StreamedCamera
from toolee_robot.devices.cameras.airo import AiroStream
from toolee_robot.errors import NoAnswerError, StaleDataError
from toolee_robot.runtime.clock import HostClock


@pytest.mark.realtime(light=True)
def test_it_gives_frames_and_its_failures_are_typed() -> None:
    camera = OnTheirBase()
    with StreamedCamera(AiroStream(lambda: camera, "42"), HostClock()) as streamed:
        frame = streamed.read()
        assert streamed.profile.serial == "42"
        assert streamed.profile.model == "OnTheirBase"
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
    def fail() -> SoftwareAiroCamera:
        raise ValueError("no device")

    with raises(NoAnswerError, says="cannot open the camera"):
        AiroStream(fail, "42").open()
