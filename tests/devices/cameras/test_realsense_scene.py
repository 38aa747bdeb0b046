"""The simulated station seen through librealsense: the networks find the held hammer in the driver's frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from toolee_robot import Category, HammeringTask, ToolPerception, nominal_grasp
from toolee_robot.depth_noise import DepthNoise
from toolee_robot.devices.cameras import StreamedCamera
from toolee_robot.devices.cameras.realsense import RealSenseStream
from toolee_robot.devices.cameras.stream import CameraMode
from toolee_robot.frames import Array
from toolee_robot.render.sensor_models import measure_depth
from toolee_robot.robots import hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.software_realsense import BASELINE, SERIAL, SoftwareRealSense
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.sim_backend.visuals import SceneVisuals, scene_state
from toolee_robot.station import sim_station
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.types import HoldingHand, RgbdFrame, ToolEstimate

rs: Any = pytest.importorskip("pyrealsense2", exc_type=ImportError)


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
