"""Build a simulated station: the same Protocols as the real one, and beside them the ground truth."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np

from toolee_robot.config import SIMULATED, StationConfig
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.hal import Station
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.clock import SimClock
from toolee_robot.sim_backend.devices.hand import SimHand
from toolee_robot.sim_backend.devices.operator import SimPerson
from toolee_robot.sim_backend.ground_truth.verdict import Judge
from toolee_robot.sim_backend.options import InHandOffset, SimOptions
from toolee_robot.sim_backend.visuals.scene import SceneVisuals, scene_state
from toolee_robot.sim_backend.world import Sample, SimWorld
from toolee_robot.tools import NAIL_DRIVERS, SWUNG_MASS, Tool, make_tool, split

MAX_MOMENT = 1.7  # [Nm] of its weight about the grip's centre: what the wrist can swing
MIN_REACH = 0.15  # [m] from the grip's centre to the face, along the handle: room for the hand


def draw_hammer(rng: np.random.Generator) -> Tool:
    """A hammer that no network was trained on, of a size that one hand swings."""
    for _ in range(200):
        seed = int(rng.integers(0, 5000))
        if split(seed) != "test":
            continue
        tool = make_tool(NAIL_DRIVERS[int(rng.integers(len(NAIL_DRIVERS)))], seed)
        face = tool.ee(Category.HAMMER_HEAD).X_tool_ee
        moment = 9.81 * tool.mass * tool.center_of_mass[2]
        if SWUNG_MASS[0] <= tool.mass <= SWUNG_MASS[1] and face[2, 3] >= MIN_REACH and moment <= MAX_MOMENT:
            return tool
    raise UserError("no hammer of a usable mass found: choose another seed")


def draw_handover(seed: int, options: SimOptions) -> tuple[Tool, InHandOffset]:
    """The tool that a seed, or an option, hands over, and how it will lie in the hand. Raises UserError for a seed
    below 0."""
    if seed < 0:
        raise UserError(f"the seed must be 0 or more, got {seed}")
    tool = draw_hammer(np.random.default_rng([seed, 10])) if options.tool is None else options.tool
    offset = InHandOffset.draw(np.random.default_rng([seed, 11])) if options.offset is None else options.offset
    return tool, offset


def build_world(config: StationConfig, tool: Tool, options: SimOptions) -> SimWorld:
    """The world before the handover: the tool hangs where the person will be."""
    x, y, _ = config.scene.person_center
    return SimWorld(config, tool, transform(p=[x, y + 0.35, 1.0]), options)


class SimStation:
    """`station`: what a task gets. `judge`, `world`, `person`: ground truth, for the report and the tests.

    with SimStation.build(StationConfig(), seed=0) as simulation:
        task(simulation.station)
    """

    def __init__(
        self, world: SimWorld, station: Station, judge: Judge, person: SimPerson, offset: InHandOffset
    ) -> None:
        self.world = world
        self.station = station
        self.judge = judge
        self.person = person
        self.offset = offset

    @classmethod
    def build(cls, config: StationConfig, seed: int = 0, options: SimOptions | None = None) -> SimStation:
        """The seed decides tool, in-hand offset, room and noise. Raises UserError for an unusable option."""
        options = SimOptions() if options is None else options
        tool, offset = draw_handover(seed, options)
        world = build_world(config, tool, options)
        try:
            person = SimPerson(world, offset, options.hands_over)
            clock = SimClock(world)
            visuals = SceneVisuals(config, tool, seed, lambda: scene_state(world, person))
            camera = SimCamera(visuals, clock, config.camera, seed)
            hand = SimHand(world, options.friction)
            station = Station(SimArm(world), hand, camera, person, clock, SIMULATED, SIMULATED)
            judge = Judge(world)
            world.after_step.append(judge.after_step)
        except BaseException:
            world.close()
            raise
        return cls(world, station, judge, person, offset)

    @property
    def tool(self) -> Tool:
        """The tool handed over: ground truth."""
        return self.world.tool.tool

    @property
    def observers(self) -> list[Callable[[Sample], None]]:
        """Called every 16 ms of simulated time with joints and wrench, for a recorder."""
        return self.world.observers

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the simulation."""
        self.world.close()
