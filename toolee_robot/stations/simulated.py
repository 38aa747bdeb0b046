"""The simulated station of a job, and printed boards in simulated and rehearsed labs.

Drawn from the seed, and unknown to whoever calibrates or looks: the print's scale, where the board really is, where the
camera really stands, and how the block's top is tilted. What a person has measured is off by what a rule, a tape
measure and a calliper are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.board import Board, Sheet
from toolee_robot.calibration.nail import OnWood
from toolee_robot.calibration.record import rows
from toolee_robot.frames import Array, transform
from toolee_robot.sim_backend.options import PlacedBoard, SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import CameraConfig, StationConfig
from toolee_robot.tasks.calibration.views import Plate


def open_station(config: StationConfig, seed: int = 0, options: SimOptions | None = None) -> SimStation:
    """Build the simulated station of a job; enter its context to use the devices.

        with open_station(sim_station(), seed=3) as simulated:
            task = HammeringTask(simulated.station, ...)

    Args:
        config: Configuration of the station.
        seed: Seed of tool, grasp and scene.
        options: Options of the simulation; None for the defaults.

    Returns:
        The station, not yet entered.

    Raises:
        UserError: The seed or an option is unusable.
    """
    return SimStation.build(config, seed, SimOptions() if options is None else options)


PRINT_SCALE = (0.985, 1.01)
"""Scales of prints."""
RULE = 1e-4
"""Standard deviation of a length that a person measures with a steel rule [m]."""
TAPE = 0.03
"""Largest error of a coordinate that a person measures with a tape [m]."""
SCREWS = 0.008, float(np.deg2rad(2.0))
"""Largest error of the plate's place on the flange along and about each axis [m], [rad]."""

AIM = 0.6
"""Distance of the point on the optical axis at which a person measures where a camera looks [m]."""
SET_BACK = 0.022
"""Distance of the simulated plate behind the print [m]."""


@dataclass(frozen=True, eq=False)
class SimulatedBoard:
    """A printed board on the flange of a simulated arm.

    Attributes:
        true: The station as it is, with the plate.
        measured: The station as a person has measured it, with the plate.
        plate: The plate as a person has measured it.
        bars: Lengths of the print's scale bars as a person has measured them [m].
        placed: The board as it is.
    """

    true: StationConfig
    measured: StationConfig
    plate: Plate
    bars: tuple[float, float]
    placed: PlacedBoard

    def build(self, seed: int) -> SimStation:
        """Build the simulated station.

        Args:
            seed: Seed of room and noise.

        Returns:
            The station; the person has stepped back, once it is asked for.
        """
        return SimStation.build(self.true, seed, SimOptions(hands_over=False, boards=(self.placed,)))


def simulated_board(config: StationConfig, sheet: Sheet, distance: float, mass: float, seed: int) -> SimulatedBoard:
    """Print a board, screw it on the flange, and measure it.

    Args:
        config: The station; its camera stands where the station file says, and not where a calibration's record does.
        sheet: The sheet that is printed.
        distance: Distance of the print from the flange [m].
        mass: Mass of plate and holder [kg].
        seed: Seed of what is drawn.

    Returns:
        The board.
    """
    rng = np.random.default_rng([seed, 30])
    config = replace(config, camera=config.camera.uncalibrated)
    board = replace(sheet.board, square=sheet.board.square * rng.uniform(*PRINT_SCALE))
    x, y = (float(length + rng.normal(0.0, RULE)) for length in board.size)
    plate = Plate(sheet.board.measured(x, y), distance, mass)
    offset = transform(
        Rotation.from_rotvec(rng.uniform(-SCREWS[1], SCREWS[1], 3)), rng.uniform(-SCREWS[0], SCREWS[0], 3)
    )
    measured = replace(plate.station(config), camera=_by_tape(config.camera, rng))
    placed = PlacedBoard(board, offset @ Plate(board, distance, mass).X_flange_board)
    # The simulated plate is a box along the flange's axes: it stands back, so that the print is before it all over.
    true = replace(plate, distance=distance - SET_BACK).station(config)
    return SimulatedBoard(true, measured, plate, (x, y), placed)


def _by_tape(camera: CameraConfig, rng: np.random.Generator) -> CameraConfig:
    def measured(point: ArrayLike) -> tuple[float, float, float]:
        x, y, z = (np.asarray(point) + rng.uniform(-TAPE, TAPE, 3)).tolist()
        return x, y, z

    if camera.measured_pose is None and camera.position is not None and camera.target is not None:
        return replace(camera, position=measured(camera.position), target=measured(camera.target))
    X = camera.uncalibrated.X_base_camera
    position, target = (np.array(measured(X[:3, 3] + distance * X[:3, 2])) for distance in (0.0, AIM))
    turn, _ = Rotation.align_vectors([target - position], [X[:3, 2]])  # the shortest: it keeps the roll
    return replace(camera, measured_pose=rows(transform(turn.as_matrix() @ X[:3, :3], position)))


WOOD_TILT = float(np.deg2rad(1.0))
"""Standard deviation of each component of the tilt of the block's top [rad]."""
THICKNESS = 0.0002, 0.005
"""Height of a print over the wood: glued on it, or on a plate that lies there [m]."""
PLACING = 3e-4
"""Standard deviation of the nail's place at the board's cross about each axis: punched by hand [m]."""
CALLIPER = 5e-5
"""Standard deviation of a thickness that is measured with a calliper [m]."""


@dataclass(frozen=True, eq=False)
class PrintOnWood:
    """A printed board on the wood, and what a person measured of it.

    Attributes:
        board: The board by the measured scale bars.
        on_wood: How it lies by a person's measurement.
        placed: The board as it is.
        entry: True place of the nail's axis in the plane of the wood, `base`, (3,) [m].
        up: True normal of the wood, (3,).
    """

    board: Board
    on_wood: OnWood
    placed: PlacedBoard
    entry: Array
    up: Array


def place_board(config: StationConfig, board: Board, height: float, turn: float, tilt: Array) -> PlacedBoard:
    """Lay a board on a station's wood, its cross at the nail.

    Args:
        config: The station as it is.
        board: The board as it is.
        height: Height of the printed plane over the wood [m].
        turn: Rotation about the vertical [rad].
        tilt: Tilt of the wood about x and y of `base`, beyond the configured one, (2,) [rad].

    Returns:
        The board.
    """
    R = Rotation.from_rotvec([*tilt, 0.0]).as_matrix() @ config.work.X_base_block[:3, :3]
    R = R @ Rotation.from_euler("z", turn).as_matrix()
    R = R @ np.diag([1.0, -1.0, -1.0])  # the board's z points away from who looks at it
    entry = config.work.p_base_entry
    return PlacedBoard(board, transform(R, entry - R[:, 2] * height - R @ board.mark), on_flange=False)


def print_on_wood(true: StationConfig, sheet: Sheet, rng: np.random.Generator, tilt: float = WOOD_TILT) -> PrintOnWood:
    """Print a board, lay it on the wood, and put the nail through its cross.

    Args:
        true: The station as it is.
        sheet: The sheet that is printed.
        rng: Source of what is drawn.
        tilt: Standard deviation of each component of the wood's tilt [rad].

    Returns:
        The board.
    """
    printed = replace(sheet.board, square=sheet.board.square * rng.uniform(*PRINT_SCALE))
    x, y = (float(length + rng.normal(0.0, RULE)) for length in printed.size)
    height = float(rng.uniform(*THICKNESS))
    placed = place_board(true, printed, height, float(rng.uniform(-np.pi, np.pi)), rng.normal(0.0, tilt, 2))
    # The nail is where the person put it: the board is not quite there.
    off = placed.X_frame_board[:3, :3] @ np.array([*rng.normal(0.0, PLACING, 2), 0.0])
    placed = replace(placed, X_frame_board=transform(p=off) @ placed.X_frame_board)
    board = sheet.board.measured(x, y)
    on_wood = OnWood((float(board.mark[0]), float(board.mark[1])), height + float(rng.normal(0.0, CALLIPER)), PLACING)
    entry = true.work.p_base_entry
    return PrintOnWood(board, on_wood, placed, entry, -placed.X_frame_board[:3, 2])
