"""The RealSense driver on librealsense's software device, and on a recording by librealsense of one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.errors import raises
from tests.examples import timed
from toolee_robot import Category, HammeringTask, ToolPerception, nominal_grasp
from toolee_robot.depth_noise import DepthNoise
from toolee_robot.devices.cameras import CameraProfile, Lens, LensModel, StreamedCamera
from toolee_robot.devices.cameras.lens import DepthRegistration
from toolee_robot.devices.cameras.realsense import RealSenseStream
from toolee_robot.devices.cameras.stream import CameraMode
from toolee_robot.errors import NoAnswerError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.render.depth_sensors import measure_depth
from toolee_robot.robots import hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.software_realsense import BASELINE, COLOR, DEPTH, SERIAL, SoftwareRealSense
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.sim_backend.visuals import SceneVisuals, scene_state
from toolee_robot.station import sim_station
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.types import HoldingHand, RgbdFrame, ToolEstimate

rs: Any = pytest.importorskip("pyrealsense2", exc_type=ImportError)
MODE = CameraMode(COLOR.width, COLOR.height, 30, exposure=0.008)


@pytest.fixture
def device() -> Iterator[SoftwareRealSense]:
    with SoftwareRealSense(rs) as device:
        yield device


def stream(device: SoftwareRealSense, mode: CameraMode = MODE, serial: str = SERIAL) -> RealSenseStream:
    return RealSenseStream(serial, mode, device.devices)


def test_its_profile_is_the_devices(device: SoftwareRealSense) -> None:
    driver = stream(device)
    profile = driver.open()
    driver.close()
    assert profile.serial == SERIAL
    assert profile.firmware == "5.16.0.1"
    assert profile.auto_exposure is False
    assert profile.depth is not None
    assert profile.X_color_depth is not None
    assert abs(profile.depth_scale - 0.001) < 1e-9
    for lens, k in ((profile.color, COLOR), (profile.depth, DEPTH)):
        np.testing.assert_allclose(lens.intrinsics.matrix, k.matrix, atol=1e-4)
    assert profile.color.model is LensModel.MODIFIED_BROWN_CONRADY
    assert not profile.depth.distorts
    np.testing.assert_allclose(profile.X_color_depth, device.X_color_depth, atol=1e-7)
    color = device.device.query_sensors()[1]
    assert color.get_option(rs.option.exposure) == 80, "in units of 0.1 ms"


@pytest.mark.realtime(light=True)
def test_frames_are_undistorted_and_registered(device: SoftwareRealSense) -> None:
    k = COLOR
    # A chessboard's corner at a known place of the true picture, and a step of the depth there.
    u, v = np.meshgrid(np.arange(k.width), np.arange(k.height))
    with StreamedCamera(stream(device), HostClock()) as camera:
        lens = camera.profile.color
        x, y = lens.rays()
        device.rgb = np.repeat(np.where((x > 0.1) ^ (y > 0.05), 200, 40)[..., None], 3, axis=2).astype(np.uint8)
        steps = (np.arange(DEPTH.width) - DEPTH.cx) / DEPTH.fx + BASELINE / 0.6 > 0.1
        device.depth = np.where(steps, 600.0, 900.0)[None].repeat(DEPTH.height, axis=0)
        time.sleep(0.1)
        frame = camera.read()
    grey = frame.rgb[..., 0].astype(float)
    left = np.argmax(grey[40, k.width // 2 :] > 120) + k.width // 2
    assert abs(left - 0.5 - (0.1 * k.fx + k.cx)) < 1.0
    inside = (u > 60) & (u < k.width - 20)
    near = frame.depth[120] < 0.75
    edge = np.argmax(near & (frame.depth[120] > 0) & inside[120])
    assert abs(edge - 0.5 - (0.1 * k.fx + k.cx)) < 1.0 + 0.5 * k.fx / DEPTH.fx, "half a pixel of the depth camera's"
    known = frame.depth[inside & (v > 20) & (v < k.height - 20)]
    assert np.mean(known > 0) > 0.95
    assert abs(np.median(known[known > 0.75]) - 0.9) < 0.003


@pytest.mark.realtime
def test_the_registration_agrees_with_the_sdks_own(device: SoftwareRealSense) -> None:
    v, u = np.mgrid[: DEPTH.height, : DEPTH.width]
    device.depth = 700.0 + 0.6 * u + 0.3 * v
    device.depth[60:150, 150:260] = 520.0
    syncer = rs.syncer(8)
    sensors = device.device.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(syncer)
    try:
        frames = _pair(syncer)
        raw = np.array(frames.get_depth_frame().get_data()).astype(np.float32) * np.float32(0.001)
        theirs = np.array(rs.align(rs.stream.color).process(frames).get_depth_frame().get_data()) * 0.001
    finally:
        for sensor in sensors:
            sensor.stop()
            sensor.close()
    driver = stream(device)
    profile: CameraProfile = driver.open()
    driver.close()
    assert profile.depth is not None
    assert profile.X_color_depth is not None
    ours = DepthRegistration(profile.depth, profile.color.intrinsics, profile.X_color_depth)(raw)
    # The SDK's is in the distorted image: look where ours would be in it.
    x, y = profile.color.rays()
    k = profile.color.intrinsics
    ours = np.asarray(cv2.remap(ours, x * k.fx + k.cx, y * k.fy + k.cy, cv2.INTER_NEAREST), np.float32)
    both = (ours > 0) & (theirs > 0)
    both[:10], both[-10:], both[:, :40], both[:, -10:] = False, False, False, False
    assert both.mean() > 0.7
    difference = np.abs(ours - theirs)[both]
    assert np.mean(difference < 0.006) > 0.97, "a neighbour's depth and its noise, but at the edges"


def _pair(syncer: Any) -> Any:
    for _ in range(200):
        came, frames = syncer.try_wait_for_frames(500)
        if came and frames.get_depth_frame() and frames.get_color_frame():
            return frames
    raise AssertionError("the SDK paired no images")


def test_what_it_cannot_do_it_refuses(device: SoftwareRealSense) -> None:
    with raises(NoAnswerError, "no_answer.camera_missing") as raised:
        stream(device, serial="1").open()
    assert SERIAL in str(raised.value)
    with raises(NotReadyError, says="the RealSense has no color image of 1280x720") as unknown:
        stream(device, CameraMode(1280, 720, 30)).open()
    assert "424x240" in str(unknown.value)
    with raises(NotReadyError, says="an exposure of 3 s"):
        stream(device, CameraMode(COLOR.width, COLOR.height, 30, exposure=3.0)).open()
    driver = stream(device)
    driver.open()
    with raises(NoAnswerError, says="close other programs that use it"):
        stream(device).open()
    driver.close()


def test_an_unknown_lens_is_refused() -> None:
    with SoftwareRealSense(rs, rs.distortion.ftheta) as device, raises(NotReadyError, "not_ready.camera_lens"):
        stream(device).open()


@timed
@pytest.mark.realtime(light=True)
def test_unplugged_it_says_so_and_can_be_opened_again(device: SoftwareRealSense, timed: bool) -> None:
    camera = StreamedCamera(stream(device), HostClock())
    with camera:
        camera.read()
        device.plugged = False
        with raises(NoAnswerError, "no_answer.camera_unplugged"):
            camera.read(max_age=3.0)
        begin = time.monotonic()
        with raises(NoAnswerError, "no_answer.camera_unplugged"):
            camera.read(max_age=3.0)
        assert not timed or time.monotonic() - begin < 0.5, "at once, once it is known"
    with raises(NoAnswerError, "no_answer.camera_missing"), camera:
        pass
    device.plugged = True
    with camera:
        camera.read()


@pytest.mark.nightly
@pytest.mark.realtime(light=True)
def test_it_plays_a_recording_of_the_sdk(device: SoftwareRealSense, tmp_path: Path) -> None:
    path = tmp_path / "frames.db3"
    _record(device, path)
    played = rs.context().load_device(str(path))
    with StreamedCamera(RealSenseStream(SERIAL, MODE, lambda: [played]), HostClock()) as camera:
        frame = camera.newer(0.0)
    assert abs(np.median(frame.depth[frame.depth > 0]) - 0.8) < 0.003
    assert Lens(frame.intrinsics).intrinsics.width == COLOR.width


def _record(device: SoftwareRealSense, path: Path) -> None:
    """Record a second through the driver; the SDK ends the file when its recorder is no longer referred to."""
    recorder = rs.recorder(str(path), device.device)
    driver = RealSenseStream(SERIAL, MODE, lambda: [recorder])
    driver.open()
    try:
        count = sum(driver.fetch(0.5) is not None for _ in range(45))
    finally:
        driver.close()
    assert count > 30


SEED = 100


class _SeenEnough(Exception):
    """The job's first frame."""


class _FirstFrame(TaskObserver):
    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:  # noqa: ARG002
        self.seen, self.X_camera_hand = frame, X_camera_hand
        raise _SeenEnough


@pytest.mark.nightly
@pytest.mark.sim(seconds=25)
def test_the_held_hammer_is_found_in_its_frames() -> None:
    station, first = sim_station(), _FirstFrame()
    config = station.camera
    with SimStation.build(station, SEED) as sim:
        task = HammeringTask(
            sim.station, PerfectPerception(sim.judge), station, nominal_grasp(sim.tool, station), observer=first
        )
        with pytest.raises(_SeenEnough):
            task.run()
        # The depth camera looks the same way, a baseline to the right of the colour camera.
        aside = config.X_base_camera[:3, 0] * BASELINE
        assert config.position is not None
        assert config.target is not None
        right = replace(config, position=_moved(config.position, aside), target=_moved(config.target, aside))
        visuals = SceneVisuals(station, sim.tool, SEED, lambda: scene_state(sim.world, sim.person))
        rendered, other = (SimCamera(visuals, sim.station.clock, place, SEED).render() for place in (config, right))
        X_base_ee = sim.world.X_base_ee()
    direct = first.seen
    k = config.intrinsics
    noise = measure_depth(other.depth, other.cos_incidence, other.shininess, k, DepthNoise(), np.random.default_rng(0))
    with SoftwareRealSense(rs, rs.distortion.none, k, k) as device:
        device.rgb, device.depth = direct.rgb, np.nan_to_num(noise).astype(np.float64) * 1e3
        mode = CameraMode(k.width, k.height, 30, exposure=0.008)
        with StreamedCamera(RealSenseStream(SERIAL, mode, device.devices), HostClock()) as camera:
            frame = camera.read()
    off = [_depth_error(seen.depth, rendered.depth) for seen in (direct, frame)]
    assert off[1] < 1.2 * off[0] + 0.001, "no worse than the noise of the depth camera"
    perception = ToolPerception.load()
    hand = HoldingHand(first.X_camera_hand, hand_model(station.hand).grasp.R_hand_tool)
    for seen in (direct, frame):
        position, angle = _error(perception.estimate(seen, hand), np.linalg.inv(config.X_base_camera) @ X_base_ee)
        assert position < 0.02
        assert angle < np.deg2rad(10.0)


def _depth_error(depth: Any, true: Any) -> float:
    known = (depth > 0) & (true > 0)
    assert known.mean() > 0.8
    return float(np.median(np.abs(depth - true)[known]))


def _moved(point: tuple[float, float, float], by: Array) -> tuple[float, float, float]:
    x, y, z = np.add(point, by)
    return float(x), float(y), float(z)


def _error(estimates: list[ToolEstimate], X_camera_ee: Array) -> tuple[float, float]:
    found = [e for e in estimates if e.category is Category.HAMMER_HEAD and e.usable]
    assert found, [(e.category, e.reason) for e in estimates]
    X = max(found, key=lambda e: e.trust).X_camera_ee
    cosine = float(np.clip(X[:3, 2] @ X_camera_ee[:3, 2], -1, 1))
    return float(np.linalg.norm(X[:3, 3] - X_camera_ee[:3, 3])), float(np.arccos(cosine))
