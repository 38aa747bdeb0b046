"""A simulated lab that calibrates its camera: a printed board on the flange, and what a person has measured there.

Drawn from the seed, and unknown to the calibration: the print's scale, where the board really sits on the flange, and
where the camera really stands. What a person has measured is off by what a rule and a tape measure are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.board import Sheet
from toolee_robot.calibration.record import rows
from toolee_robot.frames import transform
from toolee_robot.sim_backend.options import PlacedBoard, SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import CameraConfig, StationConfig
from toolee_robot.tasks.calibration.plate import Plate

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
