"""What every command that does a job has in common: its options, and what it prints."""

from __future__ import annotations

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
from toolee_robot.cli.job_panel import job_panel
from toolee_robot.cli.options import Flag
from toolee_robot.runtime.gc_pause import gc_spared
from toolee_robot.runtime.json_line import json_line
from toolee_robot.station import StationConfig

if TYPE_CHECKING:
    from toolee_robot.app.job import JobSpec
    from toolee_robot.app.sources import Source
    from toolee_robot.cli.job_console import ConsoleObserver
    from toolee_robot.viewer.live_page import LivePage  # needs the extra `viewer`

EXIT_FAILED = 1
PAGE_PORT = 8080
"""Port of the page of a running job; the next free one where it is in use."""
OnRobot = Literal[
    "full", "no_correction", "position_only", "normal_only", "one_view", "mask_centroid", "paper"
]  # fmt: skip
InSimulation = OnRobot | Literal["perfect_perception", "icp"]
VARIANT = tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: full)")
SEED = tyro.conf.arg(metavar="N", help_behavior_hint="(default: 0)")


@dataclass(frozen=True, kw_only=True)
class JobOptions:
    """Options of every job."""

    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""
    nail: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Drive this one of several nails (work.nails) alone."""
    setup: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """What is set up for this job instead of what the station has: `tool` (not of a simulated station), and of `work`
    the nail's sizes and the wood's specific gravity."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs")
    """Parent of the run's folder, which holds summary.json, recording.mcap and picture.png."""
    view: Flag = False
    """Show the job on a page of this computer, too: the page of `toolee replay`, live (extra viewer)."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the networks run: cpu or cuda."""
    paper_weights: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """For --variant paper: the folder of a training of the paper's estimator, as docs/how-to/run_trials.md tells."""

    @abstractmethod
    def source(self) -> Source:
        """Where the devices come from."""

    @property
    @abstractmethod
    def variant_name(self) -> str:
        """The variant."""

    @property
    def answered(self) -> bool:
        """Whether a person at the terminal may answer questions."""
        return True

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        with gc_spared():  # imports that take seconds
            spec = self._spec()

            from toolee_robot.app.job import run_job
        # Only somebody at a terminal can have looked at the robot.
        asked = self.answered and console.is_terminal and sys.stdin.isatty()
        with _page(spec.source.config, console, shown=self.view) as page:
            job = run_job(spec, self.out, console_observer(spec, console, page, asked=asked))
        console.print(job_panel(job.figures))
        if self.json:
            print(json_line(job.figures), flush=True)
        if job.interrupted:
            return EXIT_INTERRUPTED
        return 0 if job.figures["success"] else EXIT_FAILED

    def _spec(self) -> JobSpec:
        source = self.source()

        from toolee_robot.app.job import JobSpec

        nails = () if self.nail is None else (self.nail,)
        return JobSpec(source, Variant(self.variant_name), self.paper_weights, nails, self.device)


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

    config = spec.source.config
    ask = (lambda question: console.input(question, markup=False)) if asked else None
    return ConsoleObserver(console, config.task.flush_protrusion, len(spec.nails or config.work.names), ask, page)


@contextmanager
def _page(config: StationConfig, console: Console, *, shown: bool) -> Iterator[LivePage | None]:
    if not shown:
        yield None
        return
    from toolee_robot.viewer.live_page import LivePage

    page = LivePage(config, PAGE_PORT)
    console.print(f"[dim]The job is shown at[/dim] [bold]{page.address}[/bold]")
    try:
        yield page
    finally:
        page.close()
