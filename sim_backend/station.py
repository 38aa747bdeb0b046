"""The simulated station: devices behind the same Protocols as the real ones, and the ground truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Self

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.hal import Station
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.hand import SimHand, SimMount
from toolee_robot.sim_backend.devices.operator import SimPerson
from toolee_robot.sim_backend.judge import Judge
from toolee_robot.sim_backend.options import InHandOffset, SimOptions
from toolee_robot.sim_backend.visuals import SceneVisuals, scene_state
from toolee_robot.sim_backend.world import Sample, SimClock, SimWorld
from toolee_robot.station import SIMULATED, StationConfig, check_upright
from toolee_robot.tools import NAIL_DRIVERS, SWUNG_MASS, Tool, ToolKind, make_tool, split

MAX_MOMENT = 1.7  # [Nm] largest moment of the tool's weight about the grip's centre: what the wrist can swing
MIN_REACH = 0.15  # [m] from the grip's centre to the face, along the handle: room for the hand


def draw_hammer(rng: np.random.Generator, kinds: Sequence[ToolKind] = NAIL_DRIVERS) -> Tool:
    """Draw a hammer of the test split, which no network was trained on, of a size that one hand can swing.

    Args:
        rng: Source of randomness.
        kinds: Kinds to draw from.

    Returns:
        The tool.

    Raises:
        UserError: None of 200 candidates is usable.
    """
    for _ in range(200):
        seed = int(rng.integers(0, 5000))
        if split(seed) != "test":
            continue
        tool = make_tool(kinds[int(rng.integers(len(kinds)))], seed)
        face = tool.ee(Category.HAMMER_HEAD).X_tool_ee
        moment = 9.81 * tool.mass * tool.center_of_mass[2]
        if SWUNG_MASS[0] <= tool.mass <= SWUNG_MASS[1] and face[2, 3] >= MIN_REACH and moment <= MAX_MOMENT:
            return tool
    raise UserError("no hammer of a usable mass found: choose another seed")


def draw_handover(seed: int, options: SimOptions) -> tuple[Tool, InHandOffset]:
    """Determine the tool and its in-hand offset.

    Args:
        seed: Seed of the run, 0 or more.
        options: Options, which take precedence over the seed.

    Returns:
        The tool, and its deviation from the nominal grasp after the handover.

    Raises:
        UserError: The seed is negative or unusable.
    """
    if seed < 0:
        raise UserError(f"the seed must be 0 or more, got {seed}", code="user.seed_negative")
    tool = draw_hammer(np.random.default_rng([seed, 10])) if options.tool is None else options.tool
    offset = InHandOffset.of_job(seed) if options.offset is None else options.offset
    return tool, offset


def build_world(config: StationConfig, tool: Tool, options: SimOptions) -> SimWorld:
    """Build the world before the handover, with the tool floating at the person's place.

    Args:
        config: The station.
        tool: The tool to hand over.
        options: Options of the run.

    Returns:
        The world.

    Raises:
        ConfigError: The arm's base is tilted (`config.mounting_tilted`).
    """
    check_upright(config.arm, "the simulated world")
    x, y, _ = config.scene.person_center
    return SimWorld(config, tool, transform(p=[x, y + 0.35, 1.0]), options)


def simulated_hand(world: SimWorld, options: SimOptions) -> SimHand | SimMount:
    """Build the device of what the flange carries: a hand or a tool mount.

    Args:
        world: The world.
        options: Options of the run.

    Returns:
        The device.
    """
    return SimMount(world) if world.robot.robot.hand.clamps else SimHand(world, options.friction)


class SimStation:
    """A simulated station; create it with `SimStation.build`.

        with SimStation.build(sim_station(), seed=0) as simulation:
            task(simulation.station)

    Args:
        world: The simulated world.
        station: Its devices.
        judge: Observes the world.
        person: The simulated person.
        offset: In-hand offset of the handover.

    Attributes:
        station: The devices: all that a task may use.
        world: The simulated world: ground truth, for the report and the tests.
        judge: What truly happened: ground truth, likewise.
        person: The simulated person: ground truth, likewise.
        offset: In-hand offset of the handover: ground truth, likewise.
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
        """Build a station.

        Args:
            config: The station.
            seed: Seed of tool, in-hand offset, room and noise.
            options: Options of the run; the defaults if None.

        Returns:
            The station, with its world running.

        Raises:
            UserError: The seed or an option is unusable.
        """
        options = SimOptions() if options is None else options
        tool, offset = draw_handover(seed, options)
        world = build_world(config, tool, options)
        try:
            person = SimPerson(world, offset, options.hands_over)
            clock = SimClock(world)
            visuals = SceneVisuals(config, tool, seed, lambda: scene_state(world, person), options.boards)
            camera = SimCamera(visuals, clock, config.camera.uncalibrated, seed, options.sensor)
            hand = simulated_hand(world, options)
            station = Station(
                SimArm(world, options.wrench_errors, [seed, 13]), hand, camera, person, clock, SIMULATED, SIMULATED
            )
            judge = Judge(world)
            world.after_step.append(judge.after_step)
        except BaseException:
            world.close()
            raise
        return cls(world, station, judge, person, offset)

    @property
    def tool(self) -> Tool:
        """The tool handed over; ground truth."""
        return self.world.tool.tool

    @property
    def observers(self) -> list[Callable[[Sample], None]]:
        """Callbacks that get a `Sample` every 16 ms of simulated time, for a recorder."""
        return self.world.observers

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the simulation."""
        self.world.close()
