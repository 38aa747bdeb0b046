"""The board's plate, screwed on the flange in the place of the hand: what moves while the camera is calibrated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.calibration.board import Board
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform
from toolee_robot.station import HandConfig, StationConfig
from toolee_robot.types import MOUNT, ToolMount

THICKNESS = 0.02
"""Thickness of the box around the plate, screws included [m]."""
MARGIN = 0.03
"""By how much the box is larger than the squares, on each side [m]."""
DISTANCE = (0.04, 0.4)
"""Least and largest distance of the printed side from the flange [m]; nearer, the plate would meet the wrist."""
_STIFF = 1000.0
"""Torque at which the plate's holder yields [Nm]: never, but a mount has one."""


@dataclass(frozen=True)
class Plate:
    """A flat plate parallel to the flange, the board's print outwards and centred on the flange's axis.

    That is where the plate is to be in collision checks and plans, to a centimetre or so. The calibration determines
    where it really is.

    Attributes:
        board: The board.
        distance: Distance of the print from the flange's face [m].
        mass: Mass of plate and holder [kg].
    """

    board: Board
    distance: float
    mass: float

    def __post_init__(self) -> None:
        if not DISTANCE[0] <= self.distance <= DISTANCE[1]:
            raise UserError(
                f"a plate {self.distance} m from the flange: give {DISTANCE[0]} to {DISTANCE[1]} m: nearer, it would "
                "meet the wrist",
                code="user.plate_distance",
            )
        if not 0.05 <= self.mass <= 5.0:
            raise UserError(f"a plate of {self.mass} kg: weigh plate and holder", code="user.plate_mass")

    @property
    def X_flange_board(self) -> Array:
        """Nominal pose of the board in the flange, (4, 4): its z into the plate, its y against the flange's."""
        R = np.diag([1.0, -1.0, -1.0])
        return transform(R, np.array([0.0, 0.0, self.distance]) - R @ self.board.center)

    def station(self, config: StationConfig) -> StationConfig:
        """Put the plate in the place of a station's hand.

        Args:
            config: The station.

        Returns:
            The station that moves while the camera is calibrated.
        """
        width, height = (length + 2 * MARGIN for length in self.board.size)
        middle = self.distance - THICKNESS / 2
        mount = ToolMount(
            position=(0.0, 0.0, middle),
            handle=(1.0, 0.0, 0.0),
            working_side=(0.0, 0.0, 1.0),
            mass=self.mass,
            center_of_mass=(0.0, 0.0, middle),
            clamp_mass=self.mass / 10,
            body_size=(width, height, THICKNESS),
            body_position=(0.0, 0.0, middle),
            hinge_position=(0.0, 0.0, middle),
            hinge_axis=(0.0, 1.0, 0.0),
            stiffness=0.0,
            travel=0.1,
        )
        return replace(config, hand=HandConfig(model=MOUNT, yield_torque=_STIFF, mount=mount))
