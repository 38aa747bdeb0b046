"""The report's part about trials with a person: where person and robot disagree, and what else happened."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from toolee_robot.runtime.html_page import Page
from toolee_robot.trials.plan import TrialPlan
from toolee_robot.trials.results import Event, Happened, Record

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


def attended_section(page: Page, made: dict[str, Any]) -> None:
    """Add the section to a page.

    Args:
        page: The page.
        made: Figures of `agreement`.
    """
    page.section("Person and robot")
    if made["rehearsed"]:
        page.paragraph("A rehearsal: every device was emulated, and no nail was measured.")
    page.paragraph(
        "A nail counts as flush if the person's calipers say so and it is not bent, whatever the robot reports. "
        "The order of tools, nails, woods, repetitions and variants is random, fixed by the plan's hash."
    )
    page.table(
        ["arm", "both say flush", "only the person", "only the robot", "neither"],
        [[arm.replace("_", " "), *map(str, of.values())] for arm, of in made["flush"].items()],
    )
    touch = made["touch_against_calipers_mm"]
    if touch["nails"]:
        page.paragraph(
            f"Height of the nail's head by the robot's touch minus that by calipers, {touch['nails']} nails: median "
            f"{touch['median']:.2f} mm, at most {touch['largest']:.2f} mm to either side."
        )
    page.paragraph(f"The tool slipped in the hand, as the person says, in {made['slipped']} trials.")
    page.heading("Disagreements")
    _rows(page, ["arm", "repetition", "conditions", "the person says", "the robot says"], made["disagreements"])
    page.heading("Interruptions and repeats")
    changed = "the station file was the same in all" if made["station_files"] < 2 else "the station file was changed"
    page.paragraph(f"{made['sessions']} sessions; {changed}. {made['skipped']} trials are skipped and not done.")
    _rows(page, ["when", "what", "arm", "repetition", "conditions", "reason"], made["interruptions"])


def _rows(page: Page, heads: list[str], rows: list[dict[str, Any]]) -> None:
    if rows:
        page.table(heads, [[str(value) for value in row.values()] for row in rows], left=len(heads))
    else:
        page.paragraph("None.")


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
