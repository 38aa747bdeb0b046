"""Where the devices of a job come from, the lab's own station, and who hears of it. Simulations are in `simulated`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from toolee_robot.errors import DeviceError
from toolee_robot.hal import Station
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import StationConfig, load_lab_station, with_setup
from toolee_robot.stations.camera import open_camera
from toolee_robot.stations.lab import LabStation, check_purpose
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.hammering.grasp import Grasp, measured_grasp
from toolee_robot.tools import ToolShape

if TYPE_CHECKING:
    from toolee_robot.sim_backend.truth import Truth  # a real station loads no simulation

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
    def name(self) -> str:
        """Name of a run, as part of its folder's."""

    @property
    def real_time_factor(self) -> float | None:
        """Rate of the station's time relative to wall-clock time; None where it waits for the job."""

    @property
    def mode(self) -> str:
        """What is real and what is not, in words; empty where nothing needs to be said."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """What identifies the run, for its records."""

    def check(self, doing: Tell) -> None:
        """Look before anything that takes long whether what is most often missing is there.

        Args:
            doing: Told what is connected to.

        Raises:
            ConfigError: The station file lacks something, or its calibration does not hold.
            DeviceError: The camera does not answer.
        """

    def open(self, tell: Tell, doing: Tell) -> AbstractContextManager[Opened]:
        """Open the devices.

        Args:
            tell: Shows a prompt to the person at the station.
            doing: Told what is connected to.

        Returns:
            The context in which they are open.
        """


def lab_station(file: Path, setup: Path | None = None) -> StationConfig:
    """A lab's station for a job.

    Args:
        file: The station file.
        setup: What is set up for the job; None for what the file says.

    Returns:
        The station.

    Raises:
        ConfigError: A file cannot be read, a field is wrong, or one that a lab measures is missing.
    """
    config = load_lab_station(file)
    return config if setup is None else with_setup(config, setup)


@dataclass(frozen=True)
class Lab:
    """A lab's own station.

    Attributes:
        name: See `Source`.
        real_time_factor: See `Source`.
        config: What the station file says.
        station_file: The file.
    """

    name: ClassVar[str] = "job"
    real_time_factor: ClassVar[float | None] = 1.0
    config: StationConfig
    station_file: Path

    @property
    def mode(self) -> str:
        """See `Source`."""
        return f"station of {self.station_file.name}"

    @property
    def facts(self) -> Mapping[str, Any]:
        """See `Source`."""
        return {"source": "lab", "seed": None, "arm": "ur-rtde", "controller_profile": None, "hand_driver": True}

    def check(self, doing: Tell) -> None:
        """See `Source`."""
        check_purpose(self.config)
        assert self.config.camera.device is not None, "it has just been checked"
        doing(f"looking for the camera {self.config.camera.device.serial}")
        with open_camera(self.config.camera, HostClock()):
            pass

    @contextmanager
    def open(self, tell: Tell, doing: Tell) -> Iterator[Opened]:
        """See `Source`."""
        doing(f"this moves a real {self.config.arm.model}; `toolee rehearse hammer` moves nothing real")
        with LabStation(self.config, tell, doing=doing) as lab:
            tool = lab.tool
            words = f"{tool.name.capitalize()}, {tool.weight_in_words}"
            yield Opened(lab.station, self.config, measured_grasp(tool, self.config), tool.name, words, None)


class Waiting(Protocol):
    """Work that takes a while."""

    def update(self, text: str, /) -> None:
        """What it does now."""


class Listener(Protocol):
    """A person at a terminal, or nobody."""

    def say(self, text: str) -> None:
        """What is going on."""

    def warn(self, text: str) -> None:
        """What the person should look at, although it goes on."""

    def prompt(self, text: str) -> None:
        """What the person is to do now."""

    def doing(self, text: str) -> None:
        """What a device is doing."""

    def waiting(self, text: str) -> AbstractContextManager[Waiting]:
        """Context of work that takes a while."""


class JobObserver(TaskObserver):
    """Base class of those who watch a job. This one shows nothing and answers nothing."""

    def doing(self, text: str) -> None:
        """Called with what is being set up, before the job begins."""

    def prompt(self, text: str) -> None:
        """Called with what the person at the station is to do."""

    def opened(self, title: str, mode: str, recorder: RunRecorder) -> None:
        """Called when the devices are open.

        Args:
            title: The tool in words.
            mode: What is real and what is not, in words.
            recorder: The recorder of the job.
        """

    def live(self) -> AbstractContextManager[object]:
        """Context in which the task runs."""
        return nullcontext()

    def ask(self, question: str) -> str | None:
        """Ask the person at the terminal after a stop.

        Args:
            question: The question.

        Returns:
            The line that was typed; None where nobody answers.
        """
        _ = question
        return None
