"""The report of trials: one page with everything on it, the same figures as JSON, and every trial as a table."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from toolee_robot.recording import PICTURE, RECORDING
from toolee_robot.runtime.files import write_atomic
from toolee_robot.tasks.common.outcome import Stage, cause
from toolee_robot.trials.plan import TrialPlan
from toolee_robot.trials.results import (
    Event,
    Happened,
    Record,
    Share,
    by_conditions,
    compare,
    median,
    of_arm,
    read_results,
    read_results_file,
    share,
)
from toolee_robot.trials.run import out_of

REPORT, FIGURES = "report.html", "report.json"
"""Names of the page and of its figures, in the trials' folder."""
MEDIANS = {
    "strikes": "strikes",
    "robot_seconds": "robot's time, s",
    "nail_seconds": "of it for the nail, s",
    "pose_error_mm": "face, mm",
    "pose_error_deg": "face, °",
    "strike_offset_mm": "strike offset, mm",
    "strike_tilt_deg": "strike tilt, °",
}
"""Figures of which the medians are told, and how they are headed."""
FALSE_FLUSH = "flush_by_the_robot_alone"
"""Outcome of a trial whose nail is flush for the robot and not for the judge, or the person."""


def write_report(plan: TrialPlan, folder: Path, results: Path | None = None) -> Path:
    """Write the report of a plan's trials, of the results that there are.

    Args:
        plan: The plan.
        folder: The trials' folder, which gets the page and its figures in the place of those there.
        results: File of the results, with the jobs' folders beside it if they came with it; None for the folder's own,
            which are not read with it.

    Returns:
        The page.

    Raises:
        UserError: The results are another plan's, or the file holds none.
    """
    records, events = read_results(plan, folder) if results is None else read_results_file(plan, results)
    folder.mkdir(parents=True, exist_ok=True)
    first = of_arm(records, plan.arms[0])
    made = _figures(plan, records, events, first)
    write_atomic(folder / FIGURES, (json.dumps(made, indent=1) + "\n").encode())
    runs = RunLinks(folder, folder if results is None else results.parent)
    write_atomic(folder / REPORT, _page(plan, made, records, runs).encode())
    return folder / REPORT


def _figures(
    plan: TrialPlan, records: Sequence[Record], events: Sequence[Event], first: Sequence[Record]
) -> dict[str, Any]:
    """The report's figures, for JSON."""
    arms = {}
    for arm in plan.arms:
        mine = of_arm(records, arm)
        if not mine:
            continue
        arms[str(arm)] = {
            "flush": asdict(_share(mine)),
            "against_first": None if arm is plan.arms[0] else asdict(compare(mine, first)),
            "medians": {name: median(mine, name) for name in MEDIANS},
            "outcomes": dict(Counter(map(_outcome, mine))),
            "failures": [
                {"stage": stage, "outcome": outcome, "count": count}
                for (stage, outcome), count in Counter(_failure_kind(r) for r in mine if not r.success).items()
            ],
            "conditions": {words: asdict(_share(of)) for words, of in by_conditions(mine).items()},
        }
    tools = {str(record.figures.get("tool")) for record in records}
    return {
        "plan": asdict(plan),
        "hash": plan.hash,
        "finished": len(records),
        "of": sum(1 for _ in plan.jobs()),
        "distinct_tools": len(tools),
        "arms": arms,
        **({"attended": agreement(plan, records, events)} if plan.led else {}),
    }


def _page(plan: TrialPlan, made: dict[str, Any], records: Sequence[Record], runs: RunLinks) -> str:
    environment = Environment(loader=PackageLoader(__package__, "."), autoescape=True)
    environment.filters["words"] = _words
    shown = {"MEDIANS": MEDIANS, "PICTURE": PICTURE, "RECORDING": RECORDING, "failures": _failures(made)}
    said = {"link": runs.link, "outcome": _outcome, "cause": cause}
    page = environment.get_template("report.html")
    return page.render(plan=plan, made=made, records=records, **shown, **said) + "\n"


def _share(records: Sequence[Record]) -> Share:
    return share([record.success for record in records])


def _failures(made: dict[str, Any]) -> list[list[str]]:
    """How often each arm failed in which stage and how, in the order of the stages."""
    arms = list(made["arms"])
    counts: dict[tuple[str, str], dict[str, int]] = {}
    for arm in arms:
        for failure in made["arms"][arm]["failures"]:
            counts.setdefault((failure["stage"], failure["outcome"]), {})[arm] = failure["count"]
    stages = ["", *Stage]
    kinds = sorted(counts, key=lambda kind: (stages.index(kind[0]), -sum(counts[kind].values())))
    return [[kind[0], kind[1].replace("_", " "), *(str(counts[kind].get(arm, "")) for arm in arms)] for kind in kinds]


def _outcome(record: Record) -> str:
    outcome = str(record.figures["outcome"])
    return FALSE_FLUSH if outcome == "flush" and not record.success else outcome


def _failure_kind(record: Record) -> tuple[str, str]:
    """The stage in which the job ended, empty where that is not known, and how."""
    return str(record.figures.get("stage") or ""), _outcome(record)


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_words(size)}" for name, size in value.items()) or "none"
    return ", ".join(map(_words, value)) or "none" if isinstance(value, list | tuple) else str(value)


@dataclass(frozen=True)
class RunLinks:
    """Where a report and the folders of its jobs lie.

    Attributes:
        page: Folder of the report.
        trials: Folder of the trials, in which the jobs' folders are.
    """

    page: Path
    trials: Path

    def link(self, record: Record, words: str, file: str) -> Markup | str:
        """A link to a file of a job, where that is here: results may have come alone.

        Args:
            record: The job's result.
            words: What is clicked on.
            file: Name of the file in the job's folder.

        Returns:
            The link, relative to the report's folder; the words alone where the file is not here.
        """
        run = Path(record.figures.get("run_folder") or "").name
        if run in ("", ".."):  # a file of results may say anything
            return words
        place = out_of(record.trial, self.trials) / run / file
        if not place.is_file():
            return words
        way = Path(os.path.relpath(place.resolve(), self.page.resolve())).as_posix()
        return Markup('<a href="{0}">{1}</a>').format(quote(way), words)


INTERRUPTIONS = (Happened.NOT_BEGUN, Happened.VOID, Happened.SKIPPED, Happened.STOPPED)
"""What the report tells of what else happened, beside trials that were cut off."""


def agreement(plan: TrialPlan, records: Sequence[Record], events: Sequence[Event]) -> dict[str, Any]:
    """Compute the figures of trials with a person.

    Args:
        plan: The plan.
        records: The results that there are.
        events: What else happened.

    Returns:
        By name, for JSON: `flush` by arm and by who says so, `touch_against_calipers_mm`, `slipped`, `disagreements`,
        `skipped`, `interruptions`, `station_files`, and `sessions`.
    """
    counts: dict[str, dict[str, int]] = {}
    for record in records:
        of = counts.setdefault(str(record.trial.arm), dict.fromkeys(("both", "person", "robot", "neither"), 0))
        of[_who(record)] += 1
    differences = [difference for record in records for difference in _differences(record)]
    last = {event.trial: event for event in events if event.trial is not None}
    done = {record.trial for record in records}
    return {
        "rehearsed": not plan.on_robot,
        "flush": counts,
        "touch_against_calipers_mm": {
            "nails": len(differences),
            "median": float(np.median(differences)) if differences else None,
            "largest": float(np.max(np.abs(differences))) if differences else None,
        },
        "slipped": sum(record.figures["person"]["slipped"] for record in records),
        "disagreements": [_disagreement(record) for record in records if _who(record) in ("person", "robot")],
        "skipped": sum(event.what is Happened.SKIPPED and trial not in done for trial, event in last.items()),
        "interruptions": _interruptions(events),
        "station_files": len({event.facts["station"] for event in events if event.what is Happened.BEGUN}),
        "sessions": sum(event.what is Happened.SESSION for event in events),
    }


def _who(record: Record) -> str:
    """Who takes the nails for flush."""
    robot = bool(record.figures["robot"]["success"])
    return {(True, True): "both", (True, False): "person", (False, True): "robot"}.get(
        (record.success, robot), "neither"
    )


def _differences(record: Record) -> list[float]:
    """Touch minus calipers of each nail that both measured [mm]."""
    touched = {nail["name"]: nail["measured_protrusion_mm"] for nail in record.figures["nails"]}
    pairs = [(touched.get(nail["name"]), nail["protrusion_mm"]) for nail in record.figures["person"]["nails"]]
    return [touch - calipers for touch, calipers in pairs if touch is not None and calipers is not None]


def _disagreement(record: Record) -> dict[str, Any]:
    trial, robot = record.trial, record.figures["robot"]
    return {
        "arm": trial.arm.replace("_", " "),
        "repetition": trial.seed,
        "conditions": trial.conditions,
        "person": record.figures["reason"],
        "robot": robot["reason"],
    }


def _interruptions(events: Sequence[Event]) -> list[dict[str, Any]]:
    rows = []
    for event, after in zip(events, [*events[1:], None], strict=True):
        ended = after is not None and after.what in (Happened.SESSION, Happened.STOPPED)
        cut_off = event.what is Happened.BEGUN and ended
        if event.what not in INTERRUPTIONS and not cut_off:
            continue
        trial = event.trial
        rows.append(
            {
                "at": event.at,
                "what": "cut off" if cut_off else event.what.replace("_", " "),
                "arm": "" if trial is None else trial.arm.replace("_", " "),
                "repetition": "" if trial is None else trial.seed,
                "conditions": "" if trial is None else trial.conditions,
                "reason": event.facts.get("reason", ""),
            }
        )
    return rows
