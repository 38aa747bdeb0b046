"""A board that somebody holds before an emulated camera, and the calibration of that camera's intrinsics by it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.app.calibrate_intrinsics import IntrinsicsJob
from toolee_robot.calibration.board import SHEETS, Board, Sheet
from toolee_robot.calibration.record import IntrinsicsRecord
from toolee_robot.devices.cameras import StatedLens
from toolee_robot.frames import Array, transform
from toolee_robot.hal import Clock
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.devices.software_realsense import Pictures
from toolee_robot.sim_backend.options import PlacedBoard
from toolee_robot.sim_backend.visuals import BoardVisuals, VisualBody
from toolee_robot.station import CameraConfig
from toolee_robot.stations.camera import open_camera
from toolee_robot.stations.rehearsal.camera import ColorAndDepth, EmulatedLens, emulated_stream, lens_of
from toolee_robot.stations.simulated import PRINT_SCALE, RULE

FOCAL, CENTER = 0.004, 3.0
"""Largest error of the told focal lengths, relative, and of the principal point [px]."""
DISPLACEMENT = (4.0, 8.0)
"""Displacement of a pixel in the image's corner by the drawn lens [px]."""
TANGENTIAL = 3e-4
"""Largest tangential coefficient of the drawn lens."""
FINER = 2
"""Rendered pixels for each pixel along each edge: a print's edges are smooth."""
HELD = 8
"""Pictures for which the board is held still."""
TILT = float(np.deg2rad(45.0))
"""Largest tilt of the board."""
WIDTH = (0.35, 0.6)
"""Width of the board in the image, as a share of its width."""


def drawn_camera(camera: CameraConfig, rng: np.random.Generator) -> CameraConfig:
    """Draw the camera as it is.

    Args:
        camera: The camera as it tells itself.
        rng: Source of what is drawn.

    Returns:
        The camera with its true intrinsics and distortion.
    """
    fx, fy = (float(f * (1.0 + rng.uniform(-FOCAL, FOCAL))) for f in (camera.fx, camera.fy))
    cx, cy = (float(c + rng.uniform(-CENTER, CENTER)) for c in (camera.cx, camera.cy))
    corner = np.hypot(0.5 * camera.width / fx, 0.5 * camera.height / fy)
    k1 = float(rng.choice([-1.0, 1.0]) * rng.uniform(*DISPLACEMENT) / (fx * corner**3))
    p1, p2 = (float(p) for p in rng.uniform(-TANGENTIAL, TANGENTIAL, 2))
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, 0.0, p1, p2))


class HeldBoard:
    """What a camera sees before which somebody holds a printed board, in one way after the other.

    Args:
        camera: The camera as it is, with its distortion.
        sheet: The sheet that was printed.
        seed: Seed of the print, the poses, the room and the noise.
        clock: The station's clock.

    Attributes:
        board: The board as it is.
        bars: Lengths of its scale bars as a person has measured them [m].
        table_height: Height of the table's top over the base plane [m].
    """

    table_height = 0.0

    def __init__(self, camera: CameraConfig, sheet: Sheet, seed: int, clock: Clock) -> None:
        self._rng = np.random.default_rng([seed, 40])
        self.board = replace(sheet.board, square=sheet.board.square * self._rng.uniform(*PRINT_SCALE))
        x, y = (float(length + self._rng.normal(0.0, RULE)) for length in self.board.size)
        self.bars = (x, y)
        self._camera, self._seed, self._clock = camera, seed, clock
        self._shown = 0

    def seen_from(self, X_color_depth: Array) -> Callable[[], Pictures | None]:
        """Begin to hold it.

        Args:
            X_color_depth: Pose of the depth camera in the colour camera, (4, 4) [m].

        Returns:
            What colour and depth camera see.
        """
        lens = EmulatedLens(self._camera, FINER)
        cameras = ColorAndDepth(self, self._camera, lens, X_color_depth, self._clock, self._seed, self._rng)
        return lambda: self._pictures(cameras)

    def visual_bodies(self) -> Sequence[VisualBody]:
        """The board."""
        return list(self._held.bodies(np.eye(4)))

    def _pictures(self, cameras: ColorAndDepth) -> Pictures:
        if self._shown % HELD == 0:
            X_camera_board = held_pose(self.board, self._camera, self._rng)
            placed = PlacedBoard(self.board, self._camera.X_base_camera @ X_camera_board, on_flange=False)
            self._held = BoardVisuals(placed)
            cameras.look()
        self._shown += 1
        return cameras.take()


def held_pose(board: Board, camera: CameraConfig, rng: np.random.Generator) -> Array:
    """Draw how somebody holds a board before a camera.

    Args:
        board: The board.
        camera: The camera.
        rng: Source of what is drawn.

    Returns:
        X_camera_board, (4, 4) [m].
    """
    depth = board.size[0] * camera.fx / (rng.uniform(*WIDTH) * camera.width)
    pixel = rng.uniform(0.12, 0.88, 2) * (camera.width, camera.height)
    direction = rng.uniform(0.0, 2.0 * np.pi)
    R = Rotation.from_rotvec(rng.uniform(0.3, 1.0) * TILT * np.array([np.cos(direction), np.sin(direction), 0.0]))
    R *= Rotation.from_rotvec([0.0, 0.0, rng.uniform(-0.6, 0.6)])
    return transform(R, depth * camera.intrinsics.rays(pixel) - R.as_matrix() @ board.center)


def calibrate_held(job: IntrinsicsJob, camera: CameraConfig, count: int) -> tuple[IntrinsicsRecord, float]:
    """Calibrate an emulated camera with a drawn lens; the record, and its largest error but for a turn [px]."""
    true = drawn_camera(camera, np.random.default_rng([0, 41]))
    clock = HostClock(0.5)
    held = HeldBoard(true, SHEETS[job.sheet], 0, clock)
    board = SHEETS[job.sheet].board.measured(*held.bars)
    with (
        emulated_stream(camera, clock, held.seen_from) as stream,
        open_camera(camera, clock, check_intrinsics=False, stream=stream) as opened,
    ):
        record = job.collect(opened, clock, board, count, opened.profile.serial)
    found = StatedLens(record.intrinsics, record.distortion).lens
    return record, lens_of(true).largest_difference(found, but_for_a_turn=True)
