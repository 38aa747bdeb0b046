"""Options of a simulated run beyond the station's configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.calibration.board import Board
from toolee_robot.depth_noise import SensorKind
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.tools import Tool


@dataclass(frozen=True)
class InHandOffset:
    """Deviation of a handle in the hand from the nominal grasp, before the fingers close.

    Its range is assumed: measured are how people hold things out to each other (Chan et al., "Characterization of
    handover orientations used by humans", IROS 2015; the data sets HOH and H2O), not how a tool then lies in a robot's
    hand. A person is taken to put a handle a third of a palm's width beside where it is asked for, and to turn it by
    eye.

    Attributes:
        along: Shift along the handle [m].
        spin: Rotation about the handle [rad].
        tilt_x: Tilt about the tool's x axis [rad].
        tilt_y: Tilt about the tool's y axis [rad].
    """

    along: float = 0.0
    spin: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, size: float = 1.0) -> InHandOffset:
        """Draw an offset: uniform within +-30 mm along, +-25 deg of spin, +-12 deg of each tilt.

        Args:
            rng: Source of randomness.
            size: Factor on these ranges.

        Returns:
            The offset.
        """
        along, spin = size * rng.uniform(-0.030, 0.030), size * rng.uniform(-1, 1) * np.deg2rad(25)
        tilt_x, tilt_y = size * rng.uniform(-1, 1, 2) * np.deg2rad(12)
        return cls(float(along), float(spin), float(tilt_x), float(tilt_y))

    @classmethod
    def of_job(cls, seed: int, size: float = 1.0) -> InHandOffset:
        """Draw the offset of a job.

        Args:
            seed: Seed of the job.
            size: Factor on the ranges of `draw`.

        Returns:
            The offset.
        """
        return cls.draw(np.random.default_rng([seed, 11]), size)


@dataclass(frozen=True, eq=False)
class PlacedBoard:
    """A calibration board in the simulated world.

    Attributes:
        board: The board in its true size.
        X_frame_board: Its pose in the flange, or in `base`, (4, 4) [m].
        on_flange: Whether it is fixed to the flange; else it lies in `base`.
    """

    board: Board
    X_frame_board: Array
    on_flange: bool = True


@dataclass(frozen=True, eq=False)
class SimOptions:
    """Options of a simulated run.

    Attributes:
        gui: Whether to show pybullet's window.
        tool: The tool to hand over; drawn by the seed if None.
        offset: The in-hand offset; drawn by the seed if None.
        friction: Coefficient of friction between hand and handle.
        q_start: Joint positions of the arm at the start, (6,) [rad]; the station's home if None.
        hands_over: Whether the person hands a tool over at all.
        nail_leans: Leans of the nails in their order, which nobody tells the job: x and y of a rotation vector in the
            upright nail's axes [rad]. Those beyond the last one stand upright.
        wrench_errors: Size of the errors of the wrench that the simulated arm reports, as a share of those of the arm's
            generation; 0 for an exact reading. An arm behind a controller stand-in has its profile's instead.
        compliance: Elasticity of the arm's joints as a share of the nominal one (`physics.joint_springs`); 0 for joints
            that follow exactly.
        boards: Calibration boards in the world; nothing touches them.
        sensor: Kind of depth camera, which the seed draws; None for the nominal time-of-flight camera.
    """

    gui: bool = False
    tool: Tool | None = None
    offset: InHandOffset | None = None
    friction: float = 0.9
    q_start: Array | None = None
    hands_over: bool = True
    nail_leans: tuple[tuple[float, float], ...] = ()
    wrench_errors: float = 0.0
    compliance: float = 0.0
    boards: tuple[PlacedBoard, ...] = ()
    sensor: SensorKind | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.friction <= 2.0:
            message = f"friction {self.friction}: give 0 to 2 (skin or rubber on wood: 0.6 to 1.0)"
            raise UserError(message, code="user.friction")
