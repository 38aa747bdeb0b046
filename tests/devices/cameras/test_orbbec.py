"""The Orbbec driver on OrbbecSDK's playback device."""

from __future__ import annotations

import importlib.util
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.errors import raises
from tests.rigs.orbbec_recording import COLOR, DEPTH, SERIAL, TRANSLATION_MM, write_recording
from toolee_robot.devices.cameras import LensModel, StreamedCamera
from toolee_robot.devices.cameras.lens import DepthRegistration
from toolee_robot.devices.cameras.orbbec import OrbbecStream, sdk
from toolee_robot.devices.cameras.stream import CameraMode
from toolee_robot.errors import NoAnswerError, NotReadyError
from toolee_robot.runtime.clock import HostClock

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("pyorbbecsdk") is None, reason="needs pyorbbecsdk2, installed with --no-deps"
)
MODE = CameraMode(COLOR.width, COLOR.height, 30)


def pictures(count: int) -> list[tuple[Any, Any]]:
    """A slanted plane with a step, and noise."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[: DEPTH.height, : DEPTH.width]
    depth = 700.0 + 0.5 * u + 0.3 * v
    depth[100:190, 120:200] = 520.0
    found = []
    for _ in range(count):
        rgb = 110 + rng.integers(-5, 6, (COLOR.height, COLOR.width, 3))
        found.append((rgb.astype(np.uint8), (depth + rng.integers(-1, 2, depth.shape)).astype(np.uint16)))
    return found


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    write_recording(tmp_path / "frames.bag", pictures(75))
    return tmp_path / "frames.bag"


def stream(recording: Path, mode: CameraMode = MODE) -> OrbbecStream:
    return OrbbecStream(SERIAL, mode, lambda: {SERIAL: lambda: sdk().PlaybackDevice(str(recording))})


@pytest.mark.realtime
def test_its_frames_are_registered_and_its_profile_is_the_devices(recording: Path) -> None:
    clock = HostClock()
    with StreamedCamera(stream(recording), clock) as camera:
        profile = camera.profile
        asked = clock.now()
        frame = camera.read()
        assert frame.stamp >= asked
    assert profile.serial == SERIAL
    assert "Femto Bolt" in profile.model
    assert profile.firmware == "1.1.2"
    assert profile.depth is not None
    assert profile.X_color_depth is not None
    np.testing.assert_allclose(profile.color.intrinsics.matrix, COLOR.matrix, atol=1e-3)
    np.testing.assert_allclose(profile.depth.intrinsics.matrix, DEPTH.matrix, atol=1e-3)
    np.testing.assert_allclose(profile.X_color_depth[:3, 3] * 1e3, TRANSLATION_MM, atol=1e-3)
    assert profile.color.model is profile.depth.model is LensModel.BROWN_CONRADY
    assert profile.depth.coefficients[4:8] == pytest.approx((0.01, 0.95, 0.38, 0.04)), "k3 to k6"
    assert profile.depth_scale == pytest.approx(1e-3)
    assert np.mean(frame.depth[100:-100, 150:-150] > 0) > 0.95
    assert abs(float(np.median(frame.depth[220:260, 290:310])) - 0.524) < 0.003


@pytest.mark.realtime
def test_the_registration_agrees_with_the_sdks_own(recording: Path) -> None:
    driver = stream(recording)
    profile = driver.open()
    ob = sdk()
    align = ob.AlignFilter(align_to_stream=ob.OBStreamType.COLOR_STREAM)
    try:
        frames = driver._pipeline.wait_for_frames(1000)
        raw = np.array(np.frombuffer(frames.get_depth_frame().get_data(), np.uint16)).reshape(DEPTH.height, DEPTH.width)
        aligned = align.process(frames).as_frame_set().get_depth_frame()
        theirs = np.array(np.frombuffer(aligned.get_data(), np.uint16)).reshape(COLOR.height, COLOR.width) * 1e-3
    finally:
        driver.close()
    assert profile.depth is not None
    assert profile.X_color_depth is not None
    register = DepthRegistration(profile.depth, profile.color.intrinsics, profile.X_color_depth)
    ours = register(raw.astype(np.float32) * np.float32(1e-3))
    # The SDK's is in the distorted image: look where ours would be in it.
    x, y = profile.color.rays()
    k = profile.color.intrinsics
    seen = np.asarray(cv2.remap(ours, x * k.fx + k.cx, y * k.fy + k.cy, cv2.INTER_NEAREST), np.float32)
    both = (seen > 0) & (theirs > 0)
    assert both.mean() > 0.5
    difference = np.abs(seen - theirs)[both]
    assert np.mean(difference < 0.005) > 0.97, "a neighbour's depth and its noise, but at the edges"


def test_what_it_cannot_do_it_refuses(recording: Path) -> None:
    with raises(NoAnswerError, "no_answer.camera_missing"):
        OrbbecStream("no such", MODE).open()
    with raises(NotReadyError, says="of 1280x720 at 30 Hz") as raised:
        stream(recording, CameraMode(1280, 720, 30)).open()
    assert "640x480" in str(raised.value)


@pytest.mark.realtime
def test_at_the_end_it_is_looked_for(recording: Path) -> None:
    there = {SERIAL: lambda: sdk().PlaybackDevice(str(recording))}
    driver = OrbbecStream(SERIAL, MODE, lambda: there)
    with StreamedCamera(driver, HostClock()) as camera:
        camera.read()
        there.clear()
        begin = time.monotonic()
        with raises(NoAnswerError, "no_answer.camera_unplugged"):
            while time.monotonic() < begin + 10:
                camera.read(max_age=5.0)
