"""Where the devices of a job come from: a simulation, a lab's own station, or a rehearsal of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.hal import Station
from toolee_robot.sensor_kinds import SensorKind
from toolee_robot.sim_backend.cell_errors import EXACT, NOMINAL, CellErrors, DrawnErrors, draw_errors
from toolee_robot.sim_backend.ground_truth.verdict import Truth
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import StationConfig
from toolee_robot.stations.lab import LabStation
from toolee_robot.stations.simulated import HandDriver, StandIn, open_station
from toolee_robot.tasks.hammering.grasp import Grasp, measured_grasp
from toolee_robot.tools import Tool, ToolShape

Tell = Callable[[str], object]
"""Shows a prompt to the person at the station."""


@dataclass(frozen=True, eq=False)
class Opened:
    """The devices of a job, and what it is told.

    Attributes:
        station: The devices.
        config: What the station file says.
        grasp: Nominal grasp of the tool that is handed over.
        tool: Name of the tool.
        words: The tool in words.
        truth: Ground truth for the evaluation after the job; None for a real station.
        shape: Shape of the tool, for pictures; None where nobody knows it.
        why_late: Says what a device's error has to do with this computer; empty words for nothing.
    """

    station: Station
    config: StationConfig
    grasp: Grasp
    tool: str
    words: str
    truth: Truth | None
    shape: ToolShape | None = None
    why_late: Callable[[DeviceError], str] = lambda _: ""


class Source(Protocol):
    """Opens the devices of a job."""

    @property
    def config(self) -> StationConfig:
        """What the station file says."""

    @property
    def real_time_factor(self) -> float | None:
        """Rate of the station's time relative to wall-clock time; None where it waits for the job."""

    @property
    def mode(self) -> str:
        """What is real and what is not, in words; empty where nothing needs to be said."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """What identifies the run, for its records."""

    def open(self, tell: Tell, doing: Tell) -> AbstractContextManager[Opened]:
        """Open the devices.

        Args:
            tell: Shows a prompt to the person at the station.
            doing: Told what is connected to.

        Returns:
            The context in which they are open.
        """


@dataclass(frozen=True)
class SimulatedSource:
    """A simulated station, its arm or hand driven by the real one's driver where asked for.

    Attributes:
        config: What the station file says.
        seed: Seed of tool, grasp and noise.
        gui: Whether pybullet's window is shown.
        stand_in: Controller stand-in through which the real driver drives the arm; None for the simulated arm itself.
        hand_driver: The hand's own driver, on an emulated hand; None for the simulated hand itself.
        errors: Sizes of the errors of what the job is told. Where the station file names a calibration's record, the
            job is told that of the camera, with its own error.
        sensor: Kind of depth camera; None for the nominal time-of-flight camera.
    """

    config: StationConfig
    seed: int
    gui: bool = False
    stand_in: StandIn | None = None
    hand_driver: HandDriver | None = None
    errors: CellErrors = NOMINAL
    sensor: SensorKind | None = None

    @property
    def _drawn(self) -> DrawnErrors:
        known = None if self.config.camera.pose is None else np.zeros((6, 6))
        # A controller's profile has the errors of the wrench.
        errors = self.errors if self.stand_in is None else replace(self.errors, wrench=0.0)
        return draw_errors(errors, self.seed, known)

    @property
    def real_time_factor(self) -> float | None:
        """See `Source`."""
        return None if self.stand_in is None else self.stand_in.real_time_factor

    @property
    def mode(self) -> str:
        """See `Source`."""
        words = [f"seed {self.seed}"]
        if self.errors == EXACT:
            words.append("what the job is told is exact" if self.config.camera.pose is None else "exact but the camera")
        if self.sensor is not None:
            words.append(f"{self.sensor} depth camera")
        if self.stand_in is not None:
            words.append(f"{self.config.arm.model} over ur_rtde at {self.stand_in.host}")
            words.append(f"{self.stand_in.profile} controller")
            words.append(f"real-time factor {self.stand_in.real_time_factor:g}")
        if self.hand_driver is not None:
            words.append(f"{self.config.hand.model} by its driver")
        return ", ".join(words)

    @property
    def facts(self) -> Mapping[str, Any]:
        """See `Source`."""
        profile = None if self.stand_in is None else self.stand_in.profile
        return {
            "source": "simulation",
            "seed": self.seed,
            "arm": "sim" if self.stand_in is None else "ur-rtde",
            "controller_profile": profile,
            "hand_driver": self.hand_driver is not None,
            "sensor": self.sensor,
            "errors": self._drawn.facts,
        }

    @contextmanager
    def open(self, tell: Tell, doing: Tell) -> Iterator[Opened]:  # noqa: ARG002  (a simulation needs neither)
        """See `Source`."""
        drawn = self._drawn
        cell, options = drawn.made_of(self.config), drawn.options(SimOptions(gui=self.gui, sensor=self.sensor))
        with open_station(cell, self.seed, options, self.stand_in, self.hand_driver) as sim:
            config = self.config if self.errors == EXACT else drawn.weighed(drawn.displaced(self.config))
            sheet = drawn.measured(sim.tool, sim.tool.name).unmeasured_as(config.tool)
            grasp = measured_grasp(sheet, config)
            yield Opened(sim.station, config, grasp, sim.tool.name, _words(sim.tool), sim.judge, sim.tool)


@dataclass(frozen=True)
class RehearsalSource:
    """A lab's station with every device emulated.

    Attributes:
        config: What the station file says.
        station_file: The file.
        seed: Seed of hammer, grasp, and of the errors of what the station file says.
        factor: Rate of the station's time relative to wall-clock time.
        profile: How the arm's controller follows, measures and stops.
    """

    config: StationConfig
    station_file: Path
    seed: int
    factor: float
    profile: ProfileName

    @property
    def real_time_factor(self) -> float | None:
        """See `Source`."""
        return self.factor

    @property
    def mode(self) -> str:
        """See `Source`."""
        return (
            f"rehearsal of {self.station_file.name}, seed {self.seed}: every device emulated, {self.profile} "
            f"controller, real-time factor {self.factor:g}"
        )

    @property
    def facts(self) -> Mapping[str, Any]:
        """See `Source`."""
        from toolee_robot.stations.rehearsal import job_errors

        return {
            "source": "rehearsal",
            "seed": self.seed,
            "arm": "ur-rtde",
            "controller_profile": self.profile,
            "hand_driver": True,
            "errors": job_errors(self.config, self.station_file, self.seed).facts,
        }

    @contextmanager
    def open(self, tell: Tell, doing: Tell) -> Iterator[Opened]:
        """See `Source`."""
        from toolee_robot.stations.rehearsal import EmulatedLab, job_cell  # only a rehearsal needs all the emulators

        cell = job_cell(self.config, self.station_file, self.seed)
        config, tool = cell.measured, cell.tool
        assert config.tool is not None
        with EmulatedLab(cell, tell, self.factor, self.profile, doing=doing) as lab:
            grasp = measured_grasp(config.tool, config)
            yield Opened(lab.station, config, grasp, tool.name, _words(tool), lab.judge, tool, lab.why_late)


@dataclass(frozen=True)
class LabSource:
    """A lab's own station.

    Attributes:
        config: What the station file says.
        station_file: The file.
    """

    config: StationConfig
    station_file: Path

    @property
    def real_time_factor(self) -> float | None:
        """See `Source`."""
        return 1.0

    @property
    def mode(self) -> str:
        """See `Source`."""
        return f"station of {self.station_file.name}"

    @property
    def facts(self) -> Mapping[str, Any]:
        """See `Source`."""
        return {"source": "lab", "seed": None, "arm": "ur-rtde", "controller_profile": None, "hand_driver": True}

    @contextmanager
    def open(self, tell: Tell, doing: Tell) -> Iterator[Opened]:
        """See `Source`."""
        doing(f"this moves a real {self.config.arm.model}; --rehearse moves none")
        with LabStation(self.config, tell, doing=doing) as lab:
            tool = lab.tool
            words = f"{tool.name.capitalize()}, {tool.weight_in_words}"
            yield Opened(lab.station, self.config, measured_grasp(tool, self.config), tool.name, words, None)


def _words(tool: Tool) -> str:
    return f"{tool.kind.replace('_', ' ').capitalize()}, {tool.mass:.2f} kg, held out from training"
