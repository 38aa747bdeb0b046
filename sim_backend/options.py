"""What can be chosen about a simulated run besides the station's own configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.tools import Tool


@dataclass(frozen=True)
class InHandOffset:
    """How a handle lies in the hand, relative to the nominal pose: along it [m], about it [rad], and tilted [rad]
    about the tool's x and y axes."""

    along: float = 0.0
    spin: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> InHandOffset:
        """As people hand tools over: uniform within +-30 mm along, +-25 deg about, +-12 deg of tilt each way."""
        along, spin = rng.uniform(-0.030, 0.030), rng.uniform(-1, 1) * np.deg2rad(25)
        tilt_x, tilt_y = rng.uniform(-1, 1, 2) * np.deg2rad(12)
        return cls(float(along), float(spin), float(tilt_x), float(tilt_y))


@dataclass(frozen=True, eq=False)
class SimOptions:
    """gui: show pybullet's window. tool: this tool instead of one drawn by the seed. offset: this in-hand offset
    instead of one drawn by the seed. friction: between hand and handle. q_start: the arm's joints (6,) [rad] at the
    start, the station's home if None. hands_over: whether the person comes with a tool at all."""

    gui: bool = False
    tool: Tool | None = None
    offset: InHandOffset | None = None
    friction: float = 0.9
    q_start: Array | None = None
    hands_over: bool = True

    def __post_init__(self) -> None:
        if not 0.0 < self.friction <= 2.0:
            raise UserError(f"friction {self.friction}: give 0 to 2 (skin or rubber on wood: 0.6 to 1.0)")
