"""The simulated camera's promises, on a world of two boxes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tests.errors import raises
from tests.examples import seldom
from toolee_robot.depth_noise import KINDS, SensorKind
from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.frames import inverse, transform
from toolee_robot.hal import RgbdCamera
from toolee_robot.render.mesh import box
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.visuals import VisualBody
from toolee_robot.station import sim_station

pytestmark = pytest.mark.sim

CONFIG = sim_station().camera
CENTER = np.array(CONFIG.target)


class Boxes:
    """A `VisualWorld`: one box that can be moved."""

    table_height = 0.0

    def __init__(self) -> None:
        self.p = CENTER.copy()
        self._mesh = box((0.12, 0.12, 0.12))

    def visual_bodies(self) -> Sequence[VisualBody]:
        return [VisualBody("box", self._mesh, transform(p=self.p), "wood", (0.8, 0.6, 0.4), body_id=4)]


class Clock:
    """Simulated time that advances by sleeping alone."""

    def __init__(self) -> None:
        self.t = 0.0

    def now(self) -> float:
        return self.t

    def sleep(self, duration: float) -> None:
        self.t += duration


def test_is_the_hals_camera_and_looks_along_the_configured_line() -> None:
    camera = SimCamera(Boxes(), Clock(), CONFIG, seed=1)
    assert isinstance(camera, RgbdCamera)
    assert camera.intrinsics == CONFIG.intrinsics
    exact = camera.render()
    p = (inverse(CONFIG.X_base_camera) @ [*CENTER, 1.0])[:3]
    row, column = round(CONFIG.fy * p[1] / p[2] + CONFIG.cy), round(CONFIG.fx * p[0] / p[2] + CONFIG.cx)
    assert exact.body_ids[row, column] == 4
    assert 0.02 < p[2] - exact.depth[row, column] < 0.11  # the box's near side


def test_frames_are_new_and_follow_the_world() -> None:
    world, clock = Boxes(), Clock()
    with SimCamera(world, clock, CONFIG, seed=1) as camera:
        first = camera.read()
        second = camera.read()
        world.p = np.add(CENTER, [0.0, 0.0, 5.0])
        gone = camera.read()
    assert first.stamp < second.stamp < gone.stamp
    assert second.stamp - first.stamp == pytest.approx(1 / 30)
    assert not np.array_equal(first.depth, second.depth)  # fresh noise
    row, column = int(CONFIG.cy), int(CONFIG.cx)
    assert gone.depth[row, column] == 0 or gone.depth[row, column] > second.depth[row, column] + 0.1


@pytest.mark.parametrize("kind", seldom(*KINDS))
def test_each_kind_of_depth_camera_sees_the_boxes_with_noise_of_its_own(kind: SensorKind) -> None:
    camera, plain = (SimCamera(Boxes(), Clock(), CONFIG, 1, sensor) for sensor in (kind, None))
    first, second, usual = camera.read().depth, camera.read().depth, plain.read().depth
    assert first.shape == usual.shape
    assert first.dtype == usual.dtype
    assert not np.array_equal(first, second), "fresh noise"
    both = (first > 0) & (usual > 0)
    assert both.mean() > 0.3 * (usual > 0).mean()
    assert np.median(abs(first[both] - usual[both])) < 0.03
    again = SimCamera(Boxes(), Clock(), CONFIG, 1, kind).read().depth
    np.testing.assert_array_equal(again, first)


@pytest.mark.parametrize("kind", seldom("structured-light", "active-stereo", "filled-stereo"))
def test_frames_of_a_depth_camera_do_not_average_its_errors_out(kind: SensorKind) -> None:
    """As those of a real one that stands still; another camera's do."""

    def error(camera: SimCamera) -> np.ndarray:
        read = camera.read().depth
        return np.where((read > 0) & (abs(read - true) < 0.03), read - true, np.nan)

    one, other = (SimCamera(Boxes(), Clock(), CONFIG, seed, kind) for seed in (1, 2))
    true = one.render().depth
    first, second, third = error(one), error(one), error(other)

    def alike(a: np.ndarray, b: np.ndarray) -> float:
        both = np.isfinite(a) & np.isfinite(b)
        return float(np.corrcoef(a[both], b[both])[0, 1])

    assert alike(first, second) > 0.3
    assert alike(first, second) > alike(first, third) + 0.2


def test_a_frozen_or_closed_camera_raises() -> None:
    clock = Clock()
    camera = SimCamera(Boxes(), clock, CONFIG)
    with camera:
        camera.read()
        camera.freeze()
        with raises(StaleDataError, code="stale_data.camera"):
            camera.read(max_age=0.2)
        assert clock.now() >= 0.2
        camera.thaw()
        assert camera.read().stamp >= 0.2
    with raises(DeviceError, code="device.closed"):
        camera.read()
