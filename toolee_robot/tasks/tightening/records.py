"""What a tightening job is told, and what comes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.tasks.common.outcome import Outcome, TaskResult

SIXTH = np.pi / 3
"""Angle after which a hexagon looks the same [rad]."""


@dataclass(frozen=True, eq=False)
class NutWork:
    """A nut to tighten, as a person has measured it, and the wrench for it.

    Attributes:
        X_base_nut: Pose of the nut's middle, (4, 4): z along the bolt into the work, x parallel to a pair of flats.
        across_flats: Width of the nut [m].
        torque: Torque to tighten it to [Nm].
        jaw_turn: Angle of the jaw against the wrench's handle, about the jaw's z [rad].
        seat: Nut's axis from the middle of the jaw's flats, towards the mouth, where the nut lies well [m].
    """

    X_base_nut: Array
    across_flats: float = 0.013
    torque: float = 4.0
    jaw_turn: float = float(np.deg2rad(15.0))
    seat: float = 0.0012

    @property
    def axis(self) -> Array:
        """Direction about which a turn tightens, (3,)."""
        return self.X_base_nut[:3, 2]

    @property
    def point(self) -> Array:
        """Middle of the nut, (3,) [m]."""
        return self.X_base_nut[:3, 3]


@dataclass(frozen=True)
class Turn:
    """One stroke of the wrench as the robot measured it.

    Attributes:
        number: Number of the stroke, from 1.
        stamp: Time of its end on the station's clock [s].
        angle: Angle of the turn [rad].
        torque: Torque at its end as measured [Nm].
        measured: How often the torque was measured in it, with the jaw released for comparison.
    """

    number: int
    stamp: float
    angle: float
    torque: float
    measured: int

    def __str__(self) -> str:
        return f"stroke {self.number}: {np.rad2deg(self.angle):.0f}°, {self.torque:.1f} Nm"


@dataclass(frozen=True)
class TightenResult(TaskResult):
    """Result of a tightening job.

    Attributes:
        turns: The strokes in their order.
        torque: Torque as measured last [Nm]; None before the first stroke.
    """

    turns: tuple[Turn, ...]
    torque: float | None

    @property
    def success(self) -> bool:
        """Whether the nut is tightened."""
        return self.outcome is Outcome.TIGHTENED
