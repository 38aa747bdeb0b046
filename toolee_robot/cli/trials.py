"""`toolee trials`: the jobs of a plan that was fixed before, and their report."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line


@dataclass(frozen=True)
class Trials:
    """Run the jobs of a plan, and write their report.

    Example: toolee trials examples/trials.yaml --out trials

    The folder keeps each result as soon as there is one. The same command again goes on where it stopped, whatever
    ended it; another plan is refused. A job that ended because the machine itself stalled is repeated, and counted.

    Exit code 0: all trials are done, however they ended; 2: invalid input.
    """

    plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="YAML")]
    """The plan: docs/how-to/run_trials.md."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("trials")
    """Folder of the results: trials.jsonl, report.html, report.json, and runs/ with each job's folder."""
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: one per core)")] = None
    """Jobs side by side."""
    report_only: Flag = False
    """Run nothing: write the report of the results that there are."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.trials import load_plan, run_trials, write_report
        from toolee_robot.trials.report import figures
        from toolee_robot.trials.run import finished

        plan = load_plan(self.plan)
        jobs = len(os.sched_getaffinity(0)) if self.jobs is None else max(1, self.jobs)
        console.print(f"[bold]{escape(plan.name)}[/bold]  [dim]plan {plan.hash[:12]}, {plan.trials} seeds[/dim]")
        if self.report_only:
            records = finished(plan, self.out)
        else:
            try:
                records = run_trials(plan, self.out, jobs, lambda text: console.print(escape(text)))
            finally:
                if done := finished(plan, self.out):
                    write_report(plan, done, self.out)
        page = write_report(plan, records, self.out)
        made = figures(plan, records)
        for arm, of in made["arms"].items():
            flush = of["flush"]
            console.print(
                f"{arm:<20}{flush['hits']} of {flush['of']} flush ({flush['low']:.2f} to {flush['high']:.2f})"
            )
        for sweep in made["sweeps"]:
            console.print(f"{sweep['error']:<20}under 90 % from: {sweep['too_much']}")
        console.print(f"report: {escape(str(page))}")
        if self.json:
            print(json_line(made), flush=True)
        return 0
