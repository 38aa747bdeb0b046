"""A camera with a distorting lens, from end to end: a rendered board is distorted, and undistorted by the driver."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.hand_eye.solve import CameraCalibration, calibrate
from toolee_robot.calibration.observation import Observation, find_board
from toolee_robot.calibration.record import rows
from toolee_robot.cli.app import run
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.render.material import Rendering
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.software_realsense import Pictures
from toolee_robot.sim_backend.options import PlacedBoard
from toolee_robot.sim_backend.visuals import BoardVisuals, VisualBody
from toolee_robot.station import CameraConfig, CameraDevice, load_lab_station, sim_station
from toolee_robot.stations.camera import REALSENSE, open_camera
from toolee_robot.stations.rehearsal.camera import EmulatedLens, emulated_stream, lens_of

BOARD = SHEETS["a3"].board
WEAK = (-0.0125, 1e-3, 3e-4, -2e-4)
STRONG = (0.1, -0.02, -4e-4, 3e-4, 0.002)
"""Displace the pixels of the corners by 5 and by 29 px."""
X_FLANGE_BOARD = transform(Rotation.from_rotvec([0.02, -0.01, 0.03]), [-0.18, -0.12, 0.12])
POSES = 10
HAND_EYE = 0.4
"""Largest error of a calibrated camera at 0.95 m [mm]; without a lens it is 0.1."""
TILT, WIDTH = float(np.deg2rad(45.0)), (0.35, 0.6)
"""Largest tilt of a held board, and its width in the image as a share of the image's."""
EXACT = 0.2
"""Largest distance of a corner from where a pinhole camera has it, after undistortion [px]."""


def camera(distortion: tuple[float, ...] | None, driver: str) -> CameraConfig:
    device = CameraDevice(driver, "832112070123", 0.2)
    return replace(
        sim_station().camera,
        fx=383.2,
        fy=383.2,
        cx=319.1,
        cy=241.6,
        width=640,
        height=480,
        distortion=distortion,
        device=device,
    )


class Scene:
    """A board that fills the image, until it is held otherwise, seen through a lens, with a little noise."""

    table_height = 0.0

    def __init__(self, config: CameraConfig) -> None:
        R = Rotation.from_rotvec([0.15, -0.1, 0.02])
        self._config, self._rng = config, np.random.default_rng(0)
        self._lens = EmulatedLens(config) if lens_of(config).distorts else None
        self._place(transform(R, [0.003, 0.002, 0.262] - R.as_matrix() @ BOARD.center))

    def _place(self, X_camera_board: Array) -> None:
        self._visuals = BoardVisuals(PlacedBoard(BOARD, self._config.X_base_camera @ X_camera_board, on_flange=False))

    def hold(self, X_camera_board: Array) -> None:
        """Hold the board at a pose, (4, 4) [m]; the depth, of which no calibration is made, stays as it was."""
        self._place(X_camera_board)
        self.rgb = self._color().rgb

    def visual_bodies(self) -> list[VisualBody]:
        return list(self._visuals.bodies(np.eye(4)))

    def _color(self) -> Rendering:
        lens = self._lens
        rendering = SimCamera(self, HostClock(), self._config if lens is None else lens.rendered).render()
        return rendering if lens is None else lens(rendering)

    def seen(self, X_color_depth: Array) -> Scene:
        color = self._color()
        self.rgb, self.depth = color.rgb, color.depth
        if not np.array_equal(X_color_depth, np.eye(4)):  # a stereo module, whose depth has no distortion
            aside = replace(self._config, pose=rows(self._config.X_base_camera @ X_color_depth))
            self.depth = SimCamera(self, HostClock(), aside).render().depth
        return self

    def __call__(self) -> Pictures:
        rgb = np.clip(self.rgb + self._rng.integers(-2, 3, self.rgb.shape), 0, 255).astype(np.uint8)
        depth = np.rint(self.depth * 1e3 + self._rng.integers(-1, 2, self.depth.shape))
        return rgb, np.where(self.depth > 0, depth, 0).clip(0, 65535).astype(np.uint16)


def corners(rgb: NDArray[np.uint8]) -> dict[int, Array]:
    """Places of the board's corners in an image, by number [px]."""
    view = find_board(rgb, BOARD, 8.0)
    assert view is not None
    return dict(zip(view.ids.tolist(), view.pixels, strict=True))


def apart(some: dict[int, Array], others: dict[int, Array]) -> Array:
    """Distances of the corners that are in both images [px]."""
    both = sorted(some.keys() & others.keys())
    assert len(both) >= 0.9 * len(BOARD.corners)
    return np.array([np.linalg.norm(some[name] - others[name]) for name in both])


@pytest.mark.realtime(light=True)
@pytest.mark.parametrize("driver", [REALSENSE, pytest.param("recorded", marks=pytest.mark.nightly)])
@pytest.mark.parametrize(
    ("distortion", "most", "least"),
    [pytest.param(WEAK, 5.0, 1.0, id="weak", marks=pytest.mark.nightly), pytest.param(STRONG, 29.0, 8.0, id="strong")],
)
def test_corners_are_where_a_pinhole_camera_has_them(
    driver: str, distortion: tuple[float, ...], most: float, least: float
) -> None:
    """Through librealsense's software device, which tells the lens, and a driver that does not."""
    if driver == REALSENSE:
        pytest.importorskip("pyrealsense2", exc_type=ImportError)
    config, clock = camera(distortion, driver), HostClock()
    scene = Scene(config)
    with emulated_stream(config, clock, scene.seen) as stream, open_camera(config, clock, stream=stream) as opened:
        frame = opened.read(2.0)
        raw = opened._wait(0.0, 0.5).images.rgb
        displacement = opened.lens.lens.largest_displacement()
    assert frame.intrinsics.agrees(config.intrinsics)
    rendering = SimCamera(scene, clock, camera(None, driver)).render()
    both = (frame.depth > 0) & (rendering.depth > 0)
    assert both.mean() > 0.8
    assert np.mean(np.abs(frame.depth - rendering.depth)[both] < 0.01) > 0.98, "depth is undistorted, too"
    pinhole = corners(rendering.rgb)
    off = apart(corners(frame.rgb), pinhole)
    assert off.max() < EXACT
    assert displacement == pytest.approx(most, abs=1.0)
    lens = lens_of(config)
    k = config.intrinsics
    distorted = {n: lens.distort(k.rays(pixel)[:2]) for n, pixel in pinhole.items()}
    assert apart(corners(raw), distorted).max() < EXACT, "without undistortion they are off by the displacement"
    assert apart(corners(raw), pinhole).max() > least


def held_pose(config: CameraConfig, rng: np.random.Generator) -> Array:
    """Draw how somebody holds the board before a camera: X_camera_board, (4, 4) [m]."""
    depth = BOARD.size[0] * config.fx / (rng.uniform(*WIDTH) * config.width)
    pixel = rng.uniform(0.12, 0.88, 2) * (config.width, config.height)
    direction = rng.uniform(0.0, 2.0 * np.pi)
    R = Rotation.from_rotvec(rng.uniform(0.3, 1.0) * TILT * np.array([np.cos(direction), np.sin(direction), 0.0]))
    R *= Rotation.from_rotvec([0.0, 0.0, rng.uniform(-0.6, 0.6)])
    return transform(R, depth * config.intrinsics.rays(pixel) - R.as_matrix() @ BOARD.center)


def hand_eye(distortion: tuple[float, ...] | None, told: tuple[float, ...] | None) -> tuple[CameraCalibration, float]:
    """Calibrate a camera to the robot by a board on the flange, through librealsense's software device."""
    pytest.importorskip("pyrealsense2", exc_type=ImportError)
    true, config, clock = camera(distortion, REALSENSE), camera(told, REALSENSE), HostClock()
    scene, rng, seen = Scene(true), np.random.default_rng(0), []
    with emulated_stream(config, clock, scene.seen) as stream, open_camera(config, clock, stream=stream) as opened:
        for number in range(POSES):
            X_camera_board = held_pose(true, rng)
            scene.hold(X_camera_board)
            view = find_board(opened.read(2.0).rgb, BOARD)
            if view is not None:
                X_base_flange = true.X_base_camera @ X_camera_board @ inverse(X_FLANGE_BOARD)
                seen.append(Observation(str(number), X_base_flange, view))
        calibration = calibrate(seen, BOARD, opened.intrinsics)
    off = (calibration.X_base_camera - true.X_base_camera) @ [*calibration.target, 1.0]
    return calibration, 1e3 * float(np.linalg.norm(off))


@pytest.mark.nightly
@pytest.mark.realtime
@pytest.mark.parametrize(
    "distortion",
    [pytest.param(None, id="none"), pytest.param(WEAK, id="weak"), pytest.param(STRONG, id="strong")],
)
def test_a_camera_is_calibrated_to_the_robot_through_its_lens(distortion: tuple[float, ...] | None) -> None:
    calibration, error = hand_eye(distortion, told=distortion)
    assert not calibration.wrong
    assert error < HAND_EYE


@pytest.mark.realtime
@pytest.mark.nightly
def test_a_lens_that_nobody_tells_is_in_the_cameras_place_or_refused() -> None:
    _, error = hand_eye(WEAK, told=None)
    assert error > 4 * HAND_EYE, "what undistortion saves"
    with pytest.raises(UserError) as raised:
        hand_eye(STRONG, told=None)
    assert raised.value.code.startswith("user.calibration_")


@pytest.mark.realtime
@pytest.mark.nightly
def test_a_calibration_is_rehearsed_through_a_lens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With every driver of the lab, from the board on the arm to the record in the station file."""
    pytest.importorskip("pyrealsense2", exc_type=ImportError)
    path = rehearsal(tmp_path)
    said = yaml.safe_load(path.read_text())
    said["camera"]["distortion"] = list(STRONG)
    path.write_text(yaml.safe_dump(said))
    command = ["calibrate", "camera", "--station", str(path), "--rehearse", "--write", "--poses", "10", "--seed", "3"]
    assert run([*command, "--out", str(tmp_path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["true_error_mm"] < 0.8
    assert told["true_error_mm"] < told["target_radius_mm"]
    assert load_lab_station(path).calibration is not None
    said = yaml.safe_load(path.read_text())
    del said["camera"]["distortion"]
    path.write_text(yaml.safe_dump(said))
    with raises(ConfigError, "config.calibration_intrinsics"):  # it holds with this lens alone
        load_lab_station(path)


def rehearsal(folder: Path) -> Path:
    """The example's station file, not yet calibrated."""
    said = yaml.safe_load((Path(__file__).parents[2] / "examples" / "lab.yaml").read_text())
    del said["calibration"]
    path = folder / "rehearsal.yaml"
    path.write_text(yaml.safe_dump(said))
    return path
