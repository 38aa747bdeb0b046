"""Jobs that move nothing real: on a simulated station, or a rehearsal of a lab's own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from toolee_robot.app.sources import Opened, Tell
from toolee_robot.depth_noise import SensorKind
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import check_real_time_factor
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.sim_backend.cell_errors import EXACT, NOMINAL, CellErrors, DrawnErrors, draw_errors
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import SIMULATED, SIMULATED_CALIBRATION, StationConfig, load_station, sim_station, with_setup
from toolee_robot.stations.lab import check_purpose
from toolee_robot.tasks.hammering.grasp import measured_grasp
from toolee_robot.tools import Tool
from toolee_robot.types import ArmModel

REAL_TIME_FACTOR = {ArmModel.UR10: 0.25, ArmModel.UR10E: 0.1}
"""Default real-time factors of a rehearsal. A cycle then takes 32 and 20 ms, at least twice what the world needs for it
in a strike, so that two busy cores keep the servo's schedule within a real robot's bounds."""
REHEARSED_MINUTES = 2.0, 7.5
"""What a nail takes of the robot's time [min]: 2.3 to 7.5 in 46 rehearsals that drove one, with a mount and three hands
(docs/benchmark/rehearsals.jsonl)."""


def simulated_station(
    file: Path | None = None,
    setup: Path | None = None,
    robot: ArmModel | None = None,
    tell: Tell = lambda _: None,
) -> StationConfig:
    """The simulated station of a job.

    Args:
        file: Changes of it, as a station file; None for none.
        setup: What is set up for the job; None for what the station has.
        robot: Model of the arm; None for the station's.
        tell: Told of a calibration that a simulation ignores.

    Returns:
        The station; of a lab's file without the calibration of its real camera.

    Raises:
        ConfigError: A file cannot be read, or a field is wrong.
        UserError: The setup gives a tool.
    """
    config = sim_station() if file is None else load_station(file)
    if config.calibration is not None and config.calibration.camera_serial != SIMULATED:
        tell(f"the simulation ignores the calibration in {file}, which belongs to a real camera")
        config = replace(config, calibration=SIMULATED_CALIBRATION, camera=config.camera.uncalibrated)
    if setup is not None:
        before, config = config.tool, with_setup(config, setup)
        if config.tool is not before:
            raise UserError(f"{setup} gives a tool, but the seed chooses a simulated tool: leave `tool` out")
    return config if robot is None else replace(config, arm=replace(config.arm, model=robot))


def cell_errors(given: str) -> CellErrors:
    """Sizes of the errors of what a simulated job is told.

    Args:
        given: `nominal`, `exact`, or the path of a YAML file with sizes of some, the others nominal.

    Returns:
        The sizes.

    Raises:
        ConfigError: The file cannot be read, or a size is wrong.
    """
    known = {"nominal": NOMINAL, "exact": EXACT}
    return known[given] if given in known else read_record(Path(given), CellErrors, "list of errors")


@dataclass(frozen=True)
class Simulated:
    """A simulated station.

    Attributes:
        real_time_factor: See `Source`.
        config: What the station file says.
        seed: Seed of tool, grasp and noise.
        gui: Whether pybullet's window is shown.
        errors: Sizes of the errors of what the job is told. Where the station file names a calibration's record, the
            job is told that of the camera, with its own error.
        sensor: Kind of depth camera; None for the nominal time-of-flight camera.
    """

    real_time_factor: ClassVar[float | None] = None
    config: StationConfig
    seed: int
    gui: bool = False
    errors: CellErrors = NOMINAL
    sensor: SensorKind | None = None

    def __post_init__(self) -> None:
        _check_seed(self.seed)

    @property
    def _drawn(self) -> DrawnErrors:
        known = None if self.config.camera.pose is None else np.zeros((6, 6))
        return draw_errors(self.errors, self.seed, known)

    @property
    def name(self) -> str:
        """See `Source`."""
        return f"seed{self.seed}"

    @property
    def mode(self) -> str:
        """See `Source`."""
        words = [f"seed {self.seed}"]
        if self.errors == EXACT:
            words.append(
                "no simulated errors" if self.config.camera.pose is None else "no simulated errors except the camera's"
            )
        if self.sensor is not None:
            words.append(f"{self.sensor} depth camera")
        return ", ".join(words)

    @property
    def facts(self) -> Mapping[str, Any]:
        """See `Source`."""
        return {
            "source": "simulation",
            "seed": self.seed,
            "arm": "sim",
            "controller_profile": None,
            "hand_driver": False,
            "sensor": self.sensor,
            "errors": self._drawn.facts,
        }

    def check(self, doing: Tell) -> None:
        """See `Source`."""

    @contextmanager
    def open(self, tell: Tell, doing: Tell) -> Iterator[Opened]:  # noqa: ARG002  (a simulation needs neither)
        """See `Source`."""
        from toolee_robot.stations.simulated import open_station  # only a simulation needs the physics engine

        drawn = self._drawn
        cell, options = drawn.made_of(self.config), drawn.options(SimOptions(gui=self.gui, sensor=self.sensor))
        with open_station(cell, self.seed, options) as sim:
            config = self.config if self.errors == EXACT else drawn.weighed(drawn.displaced(self.config))
            sheet = drawn.measured(sim.tool, sim.tool.name).unmeasured_as(config.tool)
            grasp = measured_grasp(sheet, config)
            yield Opened(sim.station, config, grasp, sim.tool.name, _words(sim.tool), sim.judge, sim.tool)


@dataclass(frozen=True)
class Rehearsal:
    """A lab's station with every device emulated.

    Attributes:
        config: What the station file says.
        station_file: The file.
        seed: Seed of hammer, grasp, and of the errors of what the station file says.
        factor: Rate of the station's time relative to wall-clock time; None for the arm's default.
        profile: How the arm's controller follows, measures and stops.
    """

    config: StationConfig
    station_file: Path
    seed: int
    factor: float | None = None
    profile: ProfileName = "harsh"

    def __post_init__(self) -> None:
        _check_seed(self.seed)
        check_real_time_factor(self.real_time_factor, "127.0.0.1")

    @property
    def name(self) -> str:
        """See `Source`."""
        return f"seed{self.seed}"

    @property
    def real_time_factor(self) -> float:
        """See `Source`."""
        return REAL_TIME_FACTOR[self.config.arm.model] if self.factor is None else self.factor

    @property
    def mode(self) -> str:
        """See `Source`."""
        return (
            f"rehearsal of {self.station_file.name}, seed {self.seed}: every device emulated, {self.profile} "
            f"controller, real-time factor {self.real_time_factor:g}"
        )

    @cached_property
    def _errors(self) -> DrawnErrors:
        from toolee_robot.stations.rehearsal import job_errors

        return job_errors(self.config, self.station_file, self.seed)

    @property
    def facts(self) -> Mapping[str, Any]:
        """See `Source`."""
        return {
            "source": "rehearsal",
            "seed": self.seed,
            "arm": "ur-rtde",
            "controller_profile": self.profile,
            "hand_driver": True,
            "errors": self._errors.facts,
        }

    def check(self, doing: Tell) -> None:  # noqa: ARG002  (an emulated camera is always there)
        """See `Source`."""
        from toolee_robot.stations.rehearsal import job_cell

        check_purpose(job_cell(self.config, self.station_file, self.seed).measured)

    @contextmanager
    def open(self, tell: Tell, doing: Tell) -> Iterator[Opened]:
        """See `Source`."""
        from toolee_robot.stations.rehearsal import EmulatedLab, job_cell  # only a rehearsal needs all the emulators

        cell = job_cell(self.config, self.station_file, self.seed)
        config, tool = cell.measured, cell.tool
        assert config.tool is not None
        factor = self.real_time_factor
        least, most = (minutes / factor for minutes in REHEARSED_MINUTES)
        doing(f"expect {least:.0f} to {most:.0f} minutes for each nail, at real-time factor {factor:g}")
        with EmulatedLab(cell, tell, factor, self.profile, doing=doing) as lab:
            grasp = measured_grasp(config.tool, config)
            yield Opened(lab.station, config, grasp, tool.name, _words(tool), lab.judge, tool, lab.why_late)


def _check_seed(seed: int) -> None:
    if not 0 <= seed < 2**31:
        raise UserError(f"--seed {seed}: give a whole number from 0 to {2**31 - 1}")


def _words(tool: Tool) -> str:
    return f"{tool.kind.replace('_', ' ').capitalize()}, {tool.mass:.2f} kg, never used in training"
