"""The figures of the hammering job in README and results are those of the records that are kept beside them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.documents.blocks import ROOT
from toolee_robot.app.variant import Variant
from toolee_robot.trials import Record, TrialPlan, load_plan
from toolee_robot.trials.results import compare, of_arm, read_results_file, share

pytestmark = pytest.mark.sim(seconds=10)

KEPT = ROOT / "docs" / "benchmark"
README, PAGE = (ROOT / "README.md").read_text(), (ROOT / "docs" / "results" / "job.md").read_text()
ARMS = {
    "whole system": Variant.FULL,
    "true poses instead of estimates": Variant.PERFECT_PERCEPTION,
    "no correction": Variant.NO_CORRECTION,
}
"""How the table of variants calls each."""


NEW = "The strike of this version"
STRIKE = {
    "UR10 with a Shadow Hand": "one_strike",
    "UR10 with a mount": "one_strike_mount",
    "UR10e with a Shadow Hand": "one_strike_ur10e",
    "UR10e with a mount": "one_strike_ur10e_mount",
}
"""The stations of the strike of this version: plans of which the first seeds have run."""


@cache
def _kept(name: str) -> tuple[TrialPlan, list[Record]]:
    plan = load_plan(KEPT / f"{name}.yaml")
    records, _ = read_results_file(plan, KEPT / f"{name}.jsonl")
    for arm in plan.arms:
        seeds = [record.trial.seed for record in of_arm(records, arm)]
        asked = [trial.seed for trial in plan.jobs() if trial.arm == arm]
        assert seeds == asked[: len(seeds)], "none is left out but those that the plan names"
    return plan, records


def _rows(heading: str) -> dict[str, list[str]]:
    """Cells of the rows of the tables under a heading of the page, without emphasis, by their first one."""
    section = re.split(rf"\n##+ {heading}\n", PAGE)[1].split("\n##")[0]
    lines = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("|")]
    return {first.strip(): [cell.replace("*", "").strip() for cell in cells] for first, *cells in lines}


def _readme_row(condition: str, flush: Sequence[bool]) -> str:
    return f"| nail flush | simulated {condition} | {len(flush)} | {100.0 * sum(flush) / len(flush):.1f} % |"


def _flush(records: Sequence[Record]) -> str:
    return str(share([record.success for record in records]))


FIGURES: dict[str, tuple[tuple[str, ...], str]] = {
    "error of the face's centre": (("pose_error_mm",), "{:.1f} mm"),
    "error of the face's normal": (("pose_error_deg",), "{:.1f}°"),
    "distance of the strikes from the nail's axis": (("strike_offset_mm",), "{:.1f} mm"),
    "tilt of the strikes": (("strike_tilt_deg",), "{:.1f}°"),
    "strikes": (("strikes",), "{:.0f}"),
    "robot's time, part of it at the nail": (("robot_seconds", "nail_seconds"), "{:.0f} s"),
    "height of flush nails": (("protrusion_mm",), "{:.1f} mm"),
    "joint torque, share of the largest": (("largest_torque_share",), "{:.2f}"),
}
"""Rows of the table of all jobs: figures of a job, and how a cell tells one."""


@pytest.mark.parametrize("row", FIGURES)
def test_the_table_of_all_jobs_is_of_their_records(row: str) -> None:
    records = [record for plan in STRIKE.values() for record in of_arm(_kept(plan)[1], Variant.FULL)]
    names, form = FIGURES[row]
    if row == "height of flush nails":
        records = [record for record in records if record.success]
    values = [[f for record in records if (f := record.figures[name]) is not None] for name in names]
    kinds: list[Callable[[Any], Any]] = [np.median, lambda x: np.quantile(x, 0.95), np.max]
    assert _rows(NEW)[row] == [", ".join(form.format(kind(v)) for v in values) for kind in kinds]


def test_the_failures_that_the_page_tells_are_all_of_them() -> None:
    records = [record for plan in STRIKE.values() for record in of_arm(_kept(plan)[1], Variant.FULL)]
    failed = sorted(record.trial.seed for record in records if not record.success)
    told = PAGE.split("jobs failed:\n")[1].split("\n\nSee a failure")[0]
    assert sorted(int(seed) for seed in re.findall(r"\b14\d{3}\b", told)) == failed


@pytest.mark.parametrize("row", ARMS)
def test_the_table_of_arms_is_of_their_records(row: str) -> None:
    records = _kept("one_strike")[1]
    mine, first = of_arm(records, ARMS[row]), of_arm(records, Variant.FULL)
    flush, against, *_ = _rows(NEW)[row]
    assert flush == _flush(mine)
    if mine != first:
        found = compare(mine, first)
        assert against.split(" (p")[0] == f"{found.better} better, {found.worse} worse"
        told = re.search(r"\(p ([=<]) ([\d.]+)\)", against)
        assert told is not None
        assert found.p < float(told[2]) if told[1] == "<" else float(f"{found.p:.1g}") == float(told[2])


@pytest.mark.parametrize("station", STRIKE)
def test_the_strike_of_this_version_is_told_as_its_records_have_it(station: str) -> None:
    full = of_arm(_kept(STRIKE[station])[1], Variant.FULL)
    assert _readme_row(station, [r.success for r in full]) in README

    def median(name: str) -> float:
        return float(np.median([r.figures[name] for r in full if r.figures[name] is not None]))

    deepest = max(r.figures["deepest_mm"] for r in full if r.figures["deepest_mm"] is not None)
    assert deepest <= 20.0
    assert _rows(NEW)[station] == [
        _flush(full),
        f"{median('strikes'):.0f}",
        f"{median('contact_speed'):.2f} m/s",
        f"{median('nail_seconds'):.0f} s",
        f"{deepest:.1f} mm",
        str(sum(r.figures["outcome"] == "tool_lost" for r in full)),
        str(sum(r.figures["stops"] > 0 for r in full)),
    ]


def test_true_poses_and_no_correction_are_told_as_their_records_have_it() -> None:
    records = _kept("one_strike")[1]
    for condition, arm in (("true pose", Variant.PERFECT_PERCEPTION), ("no correction", Variant.NO_CORRECTION)):
        assert _readme_row(f"UR10 with a Shadow Hand, {condition}", [r.success for r in of_arm(records, arm)]) in README


def _check_row(cells: Sequence[str], jobs: Sequence[dict[str, Any]]) -> None:
    flush, strikes, seconds, face, beside, torque = cells
    assert flush == str(share([job["success"] for job in jobs]))
    jobs = [job for job in jobs if job["strikes"]]
    counts, times = ([job[figure] for job in jobs] for figure in ("strikes", "robot_seconds"))
    assert strikes == f"{min(counts)} to {max(counts)}"
    assert seconds == f"{min(times):.0f} to {max(times):.0f} s, median {np.median(times):.0f} s"
    errors = ("pose_error_mm", "pose_error_deg", "strike_offset_mm")
    place, direction, offset = (np.median([job[error] for job in jobs]) for error in errors)
    assert (face, beside) == (f"{place:.1f} mm, {direction:.1f}°", f"{offset:.1f} mm")
    assert torque == f"{max(job['largest_torque_share'] for job in jobs):.2f}"


@pytest.mark.parametrize(("job", "label"), [("inspire", "Inspire RH56"), ("ability", "PSYONIC Ability Hand")])
def test_the_table_of_hands_without_a_wrist_is_of_their_records(job: str, label: str) -> None:
    kept = [json.loads(line) for line in (KEPT / "hands.jsonl").read_text().splitlines()]
    seeds = [one["seed"] for one in kept if one["job"] == job]
    assert seeds == list(range(seeds[0], seeds[-1] + 1)), "none is left out"
    row = f"{label}, {seeds[0]} to {seeds[-1]}"
    _check_row(_rows("Hands without a wrist")[row], [one["figures"] for one in kept if one["job"] == job])


REHEARSED = {
    "mount": "mount",
    "shadow": "Shadow Hand",
    "ability": "PSYONIC Ability Hand",
    "inspire": "Inspire RH56, RS-485",
    "modbus": "Inspire RH56, Modbus-TCP",
}


def _rehearsals() -> list[dict[str, Any]]:
    return [json.loads(line) for line in (KEPT / "rehearsals.jsonl").read_text().splitlines()]


def _stopped(one: dict[str, Any]) -> bool:
    """Whether late data ended it."""
    return one["figures"]["outcome"] in ("person_near", "device_fault")


@pytest.mark.parametrize("job", REHEARSED)
def test_the_table_of_rehearsals_is_of_their_records(job: str) -> None:
    kept = [one for one in _rehearsals() if one["job"] == job and not _stopped(one)]
    assert len({one["seed"] for one in kept}) == len(kept) == (5 if job in ("inspire", "modbus") else 10)
    _check_row(_rows("Rehearsals")[REHEARSED[job]], [one["figures"] for one in kept])


def test_rehearsals_that_late_data_stopped_are_counted() -> None:
    stopped = [one for one in _rehearsals() if one["job"] in REHEARSED and _stopped(one)]
    assert all("late" in one["figures"]["reason"] or "servo process" in one["figures"]["reason"] for one in stopped)
    assert f"\n{len(stopped)} other tries were stopped by late data" in PAGE


STATIONS = ("inspire", "ability", "shadow", "mount")


@pytest.mark.parametrize(
    ("kind", "row"),
    [
        ("plain", "as in the example"),
        ("10e", "UR10e"),
        ("unknown", "unknown hammer"),
        ("nails", "three nails, all flush"),
    ],
)
def test_the_table_of_other_stations_is_of_their_records(kind: str, row: str) -> None:
    kept = [json.loads(line) for line in (KEPT / "stations.jsonl").read_text().splitlines()]
    jobs = [one for one in kept if one["job"].endswith(f"-{kind}")]
    assert len({one["commit"] for one in jobs}) == (2 if kind == "unknown" else 1), "the versions that the page names"
    ended = {hand: [one["figures"]["success"] for one in jobs if one["job"] == f"{hand}-{kind}"] for hand in STATIONS}
    *cells, every = _rows("Other stations")[row]
    assert cells == [f"{sum(flush)} of {len(flush)}" for flush in ended.values()]
    together = [success for flush in ended.values() for success in flush]
    assert every == str(share(together))
