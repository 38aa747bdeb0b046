"""The simulated world: all bodies in pybullet, and the only place where simulated time advances.

Time is counted in quanta of 1/4000 s: a step normally takes 1 ms, and one quantum while the tool hits the nail.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, repeat

import numpy as np

from toolee_robot.errors import DeviceError, UserError
from toolee_robot.frames import Array
from toolee_robot.robots import load_robot
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.physics.bodies import IMPACT, Furniture, StepSettings, ToolBody, pb
from toolee_robot.sim_backend.physics.grip import AssistedGrip
from toolee_robot.sim_backend.physics.nail import Nail
from toolee_robot.sim_backend.physics.robot_body import RobotBody
from toolee_robot.sim_backend.physics.wood import NailSpec
from toolee_robot.station import StationConfig
from toolee_robot.tools import Tool

QUANTUM = IMPACT.time_step  # [s]
NORMAL = StepSettings(time_step=4 * QUANTUM, iterations=50, contact_erp=0.2)
NEAR_NAIL = 0.12  # [m] distance of the face from the nail within which an impact is checked for
STRIKE_SPEED = 0.2  # [m/s] downward speed of the face above which a contact is an impact
WINDOW_QUANTA = 40  # 10 ms of short steps after the last fast approach, for the nail to come to rest
SAMPLE_QUANTA = 64  # 16 ms between two samples for the observers


@dataclass(frozen=True)
class Sample:
    """What the sensors measure at one time, for recorders.

    Attributes:
        stamp: Time [s].
        q_arm: Joint positions of the arm, (6,) [rad].
        q_hand: Joint positions of the hand, (n,) [rad].
        wrench: Wrench of the arm's force sensor, (6,) [N, Nm], axes of `base`.
    """

    stamp: float
    q_arm: Array
    q_hand: Array
    wrench: Array


class SimWorld:
    """Table, stand, block, nail, robot and tool in pybullet. Poses are in `base`, which is pybullet's world frame.

    Args:
        config: The station.
        tool: The tool.
        X_base_tool: Initial pose of the tool, 4x4.
        options: Options of the run.

    Attributes:
        config: The station.
        client: Id of pybullet's physics client; -1 once closed.
        robot: Arm and hand.
        furniture: The static bodies.
        nails: The nails by name.
        nail: The one that the tool is nearest to; the only one where there is one. Not set where there are none.
        tool: The tool's body.
        grip: The assisted grip, if there is one.
        wrench: Reads the arm's wrench, (6,) [N, Nm]; set by the force sensor.
        wait: Implementation of `advance`: `run`, unless a controller's tick loop advances the time.
        time_step: Length of the last step [s].
        before_step: Callbacks before each step, with its length [s].
        after_step: Callbacks after each step.
        observers: Callbacks with a `Sample` every 16 ms.

    Raises:
        UserError: pybullet cannot start, or cannot open its window.
    """

    nail: Nail

    def __init__(self, config: StationConfig, tool: Tool, X_base_tool: Array, options: SimOptions) -> None:
        self.config = config
        self.client = _connect(options.gui)
        self._quanta = 0
        self._settings: StepSettings | None = None
        self._window_end = 0
        self.time_step = 0.0
        self.wrench: Callable[[], Array] = lambda: np.zeros(6)
        self.wait: Callable[[float], None] = self.run
        self.before_step: list[Callable[[float], None]] = []
        self.after_step: list[Callable[[], None]] = []
        self.observers: list[Callable[[Sample], None]] = []
        pb.setGravity(0.0, 0.0, -9.81, physicsClientId=self.client)
        robot = load_robot(config.arm.model, config.arm.calibration, config.hand)
        q_arm = np.array(config.scene.home if options.q_start is None else options.q_start)
        self.robot = RobotBody(self.client, robot, q_arm, robot.hand_open, options.compliance, NORMAL.time_step)
        self.furniture = Furniture.build(self.client, config)
        self.nails = self._driven_in(options)
        if self.nails:
            self.nail = self.nails[config.work.names[0]]
        self.tool = ToolBody(self.client, tool, X_base_tool)
        self.grip: AssistedGrip | None = None
        self.robot.ignore_collisions(self.furniture.table, link=-1)

    def _driven_in(self, options: SimOptions) -> dict[str, Nail]:
        """The nails by name."""
        leans = chain(options.nail_leans, repeat((0.0, 0.0)))
        return {
            name: Nail(
                self.client, work.X_base_nail(), NailSpec.from_config(work), self.furniture.block,
                self.config.task.flush_protrusion, lean, -work.wood_normal,
            )
            for (name, work), lean in zip(self.config.work.each(), leans, strict=False)
        }  # fmt: skip

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._quanta * QUANTUM

    @property
    def tool_body(self) -> int:
        """Id of the tool's body in pybullet."""
        return self.tool.body

    @property
    def robot_body(self) -> int:
        """Id of the robot's body in pybullet."""
        return self.robot.body

    def X_base_hand(self) -> Array:
        """Pose of the palm, 4x4."""
        return self.robot.link_pose(self.robot.palm)

    def X_base_tool(self) -> Array:
        """Pose of the tool, 4x4; ground truth."""
        return self.tool.pose()

    def X_base_ee(self) -> Array:
        """Pose of the tool's end effector, 4x4; ground truth."""
        return self.tool.ee_pose()

    def advance(self, duration: float) -> None:
        """Wait for `duration` [s] of simulated time; for devices and persons in the world.

        Raises:
            DeviceError: The world is closed.
        """
        self.wait(duration)

    def run(self, duration: float) -> None:
        """Simulate `duration` [s], rounded to quanta; only for whatever drives the world.

        Raises:
            DeviceError: The world is closed.
        """
        if self.client < 0:
            raise DeviceError("the simulation is closed: use it inside its `with` block", code="device.closed")
        end = self._quanta + max(1, round(duration / QUANTUM))
        while self._quanta < end:
            self._step(end - self._quanta)

    def _step(self, most: int) -> None:
        settings = self._settings_of_step(most)
        if settings is not self._settings:
            settings.apply(self.client)
            self._settings = settings
        dt = settings.time_step
        self.robot.before_step(dt)
        for nail in self.nails.values():
            struck = nail is self.nail and settings is IMPACT and self._quanta < self._window_end
            nail.before_step(dt, struck=struck)
        if self.grip is not None:
            self.grip.before_step(dt)
        for callback in self.before_step:
            callback(dt)
        pb.stepSimulation(physicsClientId=self.client)
        self.time_step = dt
        before = self._quanta
        self._quanta += round(dt / QUANTUM)
        for after in self.after_step:
            after()
        if self.observers and self._quanta // SAMPLE_QUANTA != before // SAMPLE_QUANTA:
            sample = Sample(self.time, self.robot.arm_state()[0], self.robot.hand_state()[0], self.wrench())
            for observer in self.observers:
                observer(sample)

    def _settings_of_step(self, most: int) -> StepSettings:
        """Settings of the next step, of so many quanta at most."""
        return IMPACT if self._strike_near() or most < 4 else NORMAL

    def _strike_near(self) -> bool:
        """Whether the tool is hitting the nail or about to: close to its head and fast.

        A tool that is lowered onto the nail, or turns on it, needs no short steps.
        """
        face = self.tool.face()
        if len(self.nails) > 1:
            self.nail = min(self.nails.values(), key=lambda nail: math.dist(face, nail.entry))
        if math.dist(face, self.nail.entry) > NEAR_NAIL:
            return False
        if -self.tool.face_velocity()[2] > STRIKE_SPEED and self.nail.impact_near(self.tool.body):
            self._window_end = self._quanta + WINDOW_QUANTA
        return self._quanta < self._window_end

    def close(self) -> None:
        """Disconnect from pybullet; idempotent."""
        if self.client >= 0:
            pb.disconnect(physicsClientId=self.client)
            self.client = -1


def _connect(gui: bool) -> int:
    if gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        message = "pybullet's window needs a screen and DISPLAY is not set: leave --gui out to run headless"
        raise UserError(message, code="user.no_display")
    try:
        client = int(pb.connect(pb.GUI if gui else pb.DIRECT))
    except pb.error as error:
        raise UserError(f"pybullet cannot start: {error}") from error
    if client < 0:
        message = "pybullet cannot open its window: is there a screen (DISPLAY)? Leave --gui out to run headless"
        raise UserError(message, code="user.no_display")
    return client


class SimClock:
    """A `hal.Clock` whose time advances only while something moves or sleeps.

    Args:
        world: The simulated world.
    """

    def __init__(self, world: SimWorld) -> None:
        self._world = world

    def now(self) -> float:
        """Simulated time [s]."""
        return self._world.time

    def sleep(self, duration: float) -> None:
        """Advance the simulation by `duration` [s]; does nothing for a duration of 0 or less."""
        if duration > 0:
            self._world.advance(duration)
