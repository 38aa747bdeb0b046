"""`toolee trials`: the jobs of a plan that was fixed before, and their report."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.jobs import console_observer
from toolee_robot.cli.output import Flag, JsonOption
from toolee_robot.errors import UserError
from toolee_robot.runtime.files import read_json

if TYPE_CHECKING:
    from toolee_robot.app.job import JobSpec
    from toolee_robot.trials import TrialPlan


@dataclass(frozen=True)
class Trials(JsonOption):
    """Run the jobs of a plan, and write their report.

    Example: toolee trials examples/trials.yaml --out trials

    Each result is saved at once. The same command again continues an interrupted run; another plan is refused. A job
    that failed because the computer stalled is repeated and counted.

    A plan on a robot (`where: {run: STATION}`) leads a person through the trials, one by one, in a random order fixed
    by the plan.

    Exit code 0: all trials are done, however they ended, or the person stopped; 1: a job crashed; 2: invalid input;
    130: interrupted.
    """

    plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="YAML")]
    """The plan: docs/how-to/run_trials.md."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: trials)")] = None
    """Folder of the results: trials.jsonl, report.html, report.json, and runs/ with each job's folder."""
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: one per core)")] = None
    """Jobs side by side."""
    report_only: Flag = False
    """Run nothing, and write the report of the existing results."""
    results: Annotated[Path | None, tyro.conf.arg(metavar="JSONL", help_behavior_hint="")] = None
    """Run nothing, and write the report of this results file to --out, which must be given. A report there is
    replaced; trials there stay.
    """

    def run(self) -> int:
        console = self.console
        from toolee_robot.trials import load_plan, write_report
        from toolee_robot.trials.report import FIGURES
        from toolee_robot.trials.results import read_results

        if self.results is not None and self.out is None:
            raise UserError("--results needs --out, the folder for the report, such as `--out report`")
        out = Path("trials") if self.out is None else self.out
        plan = load_plan(self.plan)
        pairs = "repetitions" if plan.led else "seeds"
        console.print(f"[bold]{escape(plan.name)}[/bold]  [dim]plan {plan.hash[:12]}, {plan.trials} {pairs}[/dim]")
        try:
            if not self.report_only and self.results is None:
                self._do(plan, out, console)
        except BaseException:  # Ctrl-C, too: what is done is reported
            if read_results(plan, out)[0]:
                write_report(plan, out)
            raise
        page = write_report(plan, out, self.results)
        made = read_json(out / FIGURES)
        for arm, of in made["arms"].items():
            flush = of["flush"]
            console.print(
                f"{arm:<20}{flush['hits']} of {flush['of']} flush ({flush['low']:.2f} to {flush['high']:.2f})"
            )
        if plan.led and made["finished"] < made["of"]:
            console.print(f"{made['finished']} of {made['of']} trials are done. Run the same command again to continue")
        console.print(f"report: {escape(str(page))}")
        self.tell(made)
        return 0

    def _do(self, plan: TrialPlan, out: Path, console: Console) -> None:
        from toolee_robot.trials import lead_trials, run_trials

        def tell(text: str) -> None:
            console.print(text, markup=False)

        if not plan.led:
            jobs = None if self.jobs is None else max(1, self.jobs)
            run_trials(plan, out, jobs, tell)
            return
        if self.jobs not in (None, 1):
            raise UserError("leave --jobs out: in this plan a person runs one trial at a time on one robot")
        if not (console.is_terminal and sys.stdin.isatty()):
            raise UserError("a person runs this plan at the terminal, and there is none. Start it from a terminal")
        lead_trials(plan, out, lambda question: console.input(question, markup=False), tell, partial(_job, console))


def _job(console: Console, spec: JobSpec, out: Path) -> dict[str, Any]:
    """Do a job of trials with a person, who answers at this terminal."""
    from toolee_robot.app.job import run_job

    return run_job(spec, out, console_observer(spec, console, asked=True)).figures


COMMANDS = {"trials": Trials}
