"""A supervisor over an arm on paper, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.control.paper_arm import Bystander, PaperArm
from tests.errors import raises
from toolee_robot.control import (
    CollisionWorld,
    Mode,
    RobotModel,
    StrikePlan,
    Supervisor,
    slowed_to,
)
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.errors import (
    LatchedError,
    TooleeError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard
from toolee_robot.station import StationConfig
from toolee_robot.types import Payload, Trajectory

GUARD = ContactGuard(15.0)

TOOL = Payload(1.05, np.array([0.06, 0.0, -0.05]))
"""The heaviest hammer for one hand; centre of mass in the frame of its face."""


class Desk:
    """A supervisor over an arm on paper, at home."""

    def __init__(self, robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array) -> None:
        self.arm, self.person, self.world = PaperArm(home), Bystander(), world
        self.config = config
        self.supervisor = Supervisor(self.arm, self.person, robot, config, lambda: self.world)

    def move(self, change: float, speed: float = 0.5) -> Trajectory:
        """Turn the base, and the last wrist joint a little."""
        to = self.arm.q + np.array([change, 0, 0, 0, 0, 0.1])
        return joint_move(self.arm.q, to, np.full(6, speed), np.full(6, 3.0), np.full(6, 30.0))

    def slow(self, change: float = 0.3) -> Trajectory:
        return slowed_to(self.move(change), self.world, self.config.supervisor.handover_speed)

    def ready_to_swing(self, plan: StrikePlan) -> None:
        self.arm.q = plan.strike.q[0].copy()
        self.supervisor.mode = Mode.UNATTENDED
        self.supervisor.permit_swings(1.0)


def refused(desk: Desk, error: type[TooleeError], act: Callable[[], object], code: str) -> None:
    """Nothing moved, and nothing latched."""
    before = len(desk.arm.driven)
    with raises(error, code):
        act()
    assert len(desk.arm.driven) == before
    assert not desk.supervisor.latched or error is LatchedError
