"""Do a job: `sim` in simulation, `rehearse` with your station file on emulated devices, `run` with the real robot.

Only `toolee run` moves a real arm. Each task, such as `hammer`, is a sub-command; its help has examples.
"""

from __future__ import annotations

import os
import sys
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.app.variant import Variant
from toolee_robot.cli import EXIT_INTERRUPTED
from toolee_robot.cli.output import STATION, Flag, JsonOption
from toolee_robot.depth_noise import KINDS, SensorKind
from toolee_robot.errors import UserError
from toolee_robot.runtime.latency_monitor import gc_spared
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import StationConfig
from toolee_robot.types import ArmModel

if TYPE_CHECKING:
    from toolee_robot.app.job import JobSpec
    from toolee_robot.app.sources import Source
    from toolee_robot.cli.job_console import ConsoleObserver
    from toolee_robot.viewer.rerun_page import LivePage  # needs the extra `viewer`

EXIT_FAILED = 1
PAGE_PORT = 8080
"""Port of the page of a running job; the next free one where it is in use."""
OnRobot = Literal["full", "no_correction", "paper"]
InSimulation = OnRobot | Literal["perfect_perception"]
VARIANT = tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: full)")
SEED = tyro.conf.arg(metavar="N", help_behavior_hint="(default: 0)")


@dataclass(frozen=True, kw_only=True)
class JobOptions(JsonOption):
    """Options of every job."""

    nail: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Drive this one of several nails (work.nails) alone."""
    setup: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """File with changes for this job: `tool` (not in a simulated station), and from `work` the nail's sizes and the
    wood's specific gravity.
    """
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs")
    """Parent of the run's folder, which holds summary.json, recording.mcap and picture.png."""
    view: Flag = False
    """Also show the job live in the browser, as `toolee replay` shows a past one (extra `viewer`)."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the networks run: cpu or cuda."""
    variant: Annotated[InSimulation, VARIANT] = "full"
    """A baseline instead of the whole system (docs/how-to/run_trials.md): no_correction, perfect_perception,
    paper.
    """
    paper_weights: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """For --variant paper: the folder of a training of the paper's estimator (docs/how-to/run_trials.md)."""

    @abstractmethod
    def source(self) -> Source:
        """Where the devices come from."""

    @property
    def answered(self) -> bool:
        """Whether a person at the terminal may answer questions."""
        return True

    def run(self) -> int:
        console = self.console
        with gc_spared():  # imports that take seconds
            spec = self._spec()

            from toolee_robot.app.job import run_job
            from toolee_robot.cli.job_console import job_panel
        # Only somebody at a terminal can have looked at the robot.
        asked = self.answered and console.is_terminal and sys.stdin.isatty()
        with _page(spec.source.config, console, shown=self.view) as page:
            job = run_job(spec, self.out, console_observer(spec, console, page, asked=asked))
        console.print(job_panel(job.figures))
        self.tell(job.figures)
        if job.interrupted:
            return EXIT_INTERRUPTED
        return 0 if job.figures["success"] else EXIT_FAILED

    def _spec(self) -> JobSpec:
        source = self.source()

        from toolee_robot.app.job import JobSpec

        nails = () if self.nail is None else (self.nail,)
        return JobSpec(source, Variant(self.variant), self.paper_weights, nails, self.device)


def console_observer(spec: JobSpec, console: Console, page: LivePage | None = None, *, asked: bool) -> ConsoleObserver:
    """Who watches a job at the terminal.

    Args:
        spec: The job.
        console: The console.
        page: The page in the browser that shows the job, too; None for none.
        asked: Whether a person is there to answer.

    Returns:
        The observer.
    """
    from toolee_robot.cli.job_console import ConsoleObserver  # takes seconds to import

    ask = (lambda question: console.input(question, markup=False)) if asked else None
    config = spec.source.config
    return ConsoleObserver(console, len(spec.nails or config.work.names), config.task.flush_protrusion, ask, page)


@contextmanager
def _page(config: StationConfig, console: Console, *, shown: bool) -> Iterator[LivePage | None]:
    if not shown:
        yield None
        return
    from toolee_robot.viewer.rerun_page import LivePage

    page = LivePage(config, PAGE_PORT)
    console.print(f"[dim]The job is shown at[/dim] [bold]{page.address}[/bold]")
    try:
        yield page
    finally:
        page.close()


@dataclass(frozen=True, kw_only=True)
class SimHammer(JobOptions):
    """Take a hammer, look at it, and drive a simulated nail.

    Nothing real moves.

    Example: toolee sim hammer --seed 100

    Example: toolee sim hammer --station examples/nails.yaml --nail left

    Several nails of the station are driven in their order, with the same tool. If one bends, sticks or is missed, the
    job goes on with the next.

    Exit code 0: every nail is flush; 1: one is not, with the reason; 2: invalid input; 130: interrupted.
    """

    seed: Annotated[int, SEED] = 0
    """Seed of the hammer (none was used in training), the grasp and the noise."""
    config: Annotated[Path | None, STATION] = None
    """Changes to the simulated station: any of the fields in docs/reference/station_file.md."""
    robot: Annotated[Literal["UR10", "UR10e"] | None, tyro.conf.arg(metavar="UR10|UR10e", help_behavior_hint="")] = None
    """Model of the arm, instead of the configured one."""
    errors: Annotated[str, tyro.conf.arg(metavar="nominal|exact|YAML")] = "nominal"
    """Simulated errors of the station: nominal (a careful person's), exact (none), or a file with sizes
    (docs/concepts/cell_errors.md).
    """
    sensor: Annotated[
        SensorKind | None, tyro.conf.arg(metavar="|".join(KINDS), help_behavior_hint="(default: one without those)")
    ] = None
    """Kind of the depth camera, with random errors of a real one: docs/dataset.md."""
    gui: Flag = False
    """Show pybullet's window (needs a screen)."""

    @property
    def answered(self) -> bool:
        return not self.json  # a script that was started at a terminal would wait for an answer

    def source(self) -> Source:
        if self.gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            raise UserError(
                "--gui needs a screen and DISPLAY is not set: leave it out, headless does the same job",
                code="user.no_display",
            )
        from toolee_robot.app.simulated import Simulated, cell_errors, simulated_station

        robot = None if self.robot is None else ArmModel(self.robot)
        config = simulated_station(self.config, self.setup, robot, lambda text: print(text, file=sys.stderr))
        return Simulated(config, self.seed, self.gui, cell_errors(self.errors), self.sensor)


@dataclass(frozen=True, kw_only=True)
class RehearseHammer(JobOptions):
    """Drive a nail with your drivers on emulated devices.

    Emulated devices in a simulated cell take the place of yours.

    Example: toolee rehearse hammer rehearsal.yaml --seed 3

    Nothing real moves. The seed chooses the hammer and the station's errors. The command first prints the expected
    minutes.

    Exit code 0: every nail is flush; 1: one is not, with the reason; 2: invalid input; 130: interrupted.
    """

    station: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATION")]
    """Your station file, complete: docs/how-to/first_nail.md."""
    seed: Annotated[int, SEED] = 0
    """Seed of the hammer (none was used in training), the grasp, the noise and the station's errors."""
    real_time_factor: Annotated[
        float | None, tyro.conf.arg(metavar="0.05..1", help_behavior_hint="(default: UR10 0.25, UR10e 0.1)")
    ] = None
    """Speed of the station's time; 1 is real time, which a busy computer does not sustain."""
    profile: Annotated[ProfileName, tyro.conf.arg(metavar="ideal|harsh")] = "harsh"
    """How the controller follows, measures and stops. ideal: without errors; harsh: with noise, lag and stops like a
    real one's.
    """

    def source(self) -> Source:
        from toolee_robot.app.simulated import Rehearsal
        from toolee_robot.app.sources import lab_station

        config = lab_station(self.station, self.setup)
        return Rehearsal(config, self.station, self.seed, self.real_time_factor, self.profile)


@dataclass(frozen=True, kw_only=True)
class RunHammer(JobOptions):
    """Drive a nail with the real robot. The arm moves.

    Every device of the station file is opened by its driver.

    Example: toolee run hammer lab.yaml

    Rehearse it first (`toolee rehearse hammer`). Several nails of the station are driven in their order.

    After a stop with the hammer in the hand a person at the terminal may resume the job, or have the hand opened.

    Exit code 0: every nail is flush; 1: one is not, with the reason; 2: invalid input; 130: interrupted, the arm was
    stopped.
    """

    station: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATION")]
    """Your station file, complete: docs/how-to/first_nail.md."""
    variant: Annotated[OnRobot, VARIANT] = "full"
    """A baseline instead of the whole system (docs/how-to/run_trials.md)."""

    def source(self) -> Source:
        from toolee_robot.app.sources import Lab, lab_station

        return Lab(lab_station(self.station, self.setup), self.station)


@dataclass(frozen=True, kw_only=True)
class SimTighten(JsonOption):
    """Take a wrench, look at it, and tighten a simulated nut.

    Nothing real moves.

    Example: toolee sim tighten --seed 100

    The nut is M8. The jaw slides on, turns it by 60 degrees and slides off, until the arm measures the torque.

    Exit code 0: the nut is tight; 1: it is not, with the reason; 2: invalid input; 130: interrupted.
    """

    seed: Annotated[int, SEED] = 0
    """Seed of the wrench (none was used in training), the nut, the grasp and the noise."""
    torque: Annotated[float, tyro.conf.arg(metavar="NM")] = 4.0
    """Torque to tighten to, 2 to 4 Nm: what the hand bears."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs")
    """Parent of the run's folder, which holds summary.json, recording.mcap and picture.png."""
    errors: Annotated[str, tyro.conf.arg(metavar="nominal|exact|YAML")] = "nominal"
    """Simulated errors of the station (docs/concepts/cell_errors.md)."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the networks run: cpu or cuda."""
    variant: Annotated[Literal["full", "no_correction"], VARIANT] = "full"
    """A baseline instead of the whole system."""

    def run(self) -> int:
        console = self.console
        with gc_spared():  # imports that take seconds
            from toolee_robot.app.simulated import cell_errors
            from toolee_robot.app.tighten import TightenSpec, run_tighten

        spec = TightenSpec(self.seed, self.torque, Variant(self.variant), cell_errors(self.errors), self.device)
        job = run_tighten(spec, self.out, lambda text: console.print(f"  {text}", markup=False))
        for name in ("outcome", "reason", "strokes", "measured_torque", "torque", "run_folder"):
            console.print(f"{name.replace('_', ' '):<18}{job.figures[name]}", markup=False)
        self.tell(job.figures)
        if job.figures["outcome"] == "interrupted":
            return EXIT_INTERRUPTED
        return 0 if job.figures["success"] else EXIT_FAILED


COMMANDS = {
    "sim": {"hammer": SimHammer, "tighten": SimTighten},
    "rehearse": {"hammer": RehearseHammer},
    "run": {"hammer": RunHammer},
}
