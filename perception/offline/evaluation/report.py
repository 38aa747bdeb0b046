"""The tables of `toolee evaluate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from toolee_robot.end_effectors import Category, label_of
from toolee_robot.perception.offline.evaluation.pose import GROUPS
from toolee_robot.perception.offline.evaluation.segmentation import STATISTICS

MASKS = {"truth": "true masks", "predicted": "predicted masks"}
"""Kinds of masks, and how the report calls them."""
_SHOWN = ("5deg2cm", "10deg5cm", "5deg1cm", "5deg5mm")
"""Thresholds of the tables; report.json has all."""


@dataclass(frozen=True)
class Table:
    """One table of a report.

    Attributes:
        title: Its title.
        columns: Headings.
        rows: Cells of each row, as text.
        left: Number of left-aligned columns.
    """

    title: str
    columns: Sequence[str]
    rows: list[list[str]]
    left: int = 1


def pose_tables(report: dict[str, Any]) -> list[Table]:
    """Tables of `toolee evaluate pose`.

    Args:
        report: Its record, what `run.evaluate_pose` gives.

    Returns:
        Accuracy by group and kind of masks, usable poses, what a picture shows, frames without a tool, time.
    """
    estimators, tables = report["estimators"], []
    for masks, text in MASKS.items():
        for group in GROUPS:
            found = [
                (label, record[masks]["groups"][group])
                for label, record in estimators.items()
                if group in record.get(masks, {}).get("groups", {})
            ]
            if found:
                tables.append(_accuracy(f"{group} instances, {text}", found))
    of_masks = [(label, m, record[m]) for label, record in estimators.items() for m in MASKS if m in record]
    keys = ("right_10deg2cm", "wrong_per_image", "found_10deg2cm")
    usable = [
        [label, MASKS[masks], str(record["usable"]["poses"]), *_shares(record["usable"], keys)]
        for label, masks, record in of_masks
    ]
    heads = ("estimator", "masks", "usable poses", "10deg2cm", "wrong an image", "EEs with a right one")
    tables.append(Table("acting on every usable pose, false alarms included", heads, usable, 2))
    label, masks, record = next(each for each in reversed(of_masks) if each[0] == of_masks[0][0])
    rows = [
        ["" if k else axis, group, str(row["instances"]), str(row["left_out"]), *_shares(row, _SHOWN)]
        for axis, groups in record["breakdown"].items()
        for k, (group, row) in enumerate(groups.items())
    ]
    title = f"{label}, {MASKS[masks]}, by what the picture shows"
    tables.append(Table(title, ("by", "", "n", "no depth", *_SHOWN), rows, 2))
    if "no_tool" in report:
        row = [str(report["no_tool"][k]) for k in ("frames", "with_a_detection", "with_a_usable_pose")]
        tables.append(Table("without a tool", ("frames", "with a detection", "with a usable pose"), [row], 0))
    times = [
        [label, MASKS[masks], *_numbers(t, ("median_ms", "p90_ms")), f"{t['device']}, {t['torch_threads']} threads"]
        for label, masks, record in of_masks
        for t in [record["latency"]]
    ]
    tables.append(Table("time of one pose", ("estimator", "masks", "median ms", "90 % ms", "on"), times, 2))
    return tables


def _accuracy(title: str, found: list[tuple[str, dict[str, Any]]]) -> Table:
    """The metrics of one group under one kind of masks: by category a row for each estimator."""
    categories = sorted(dict.fromkeys(c for _, t in found for c in t["table"]), key="average".__eq__)
    rows = [
        [
            *(label_of(category), label, str(row["instances"]), *_shares(row, (*_SHOWN, "usable_share"))),
            *_numbers(row, ("median_mm", "p95_mm", "median_deg", "p95_deg", "spin_with_hand_median_deg")),
        ]
        for category in categories
        for label, t in found
        if (row := t["table"].get(category)) is not None
    ]
    errors = ("mm", "95 %", "deg", "95 %", "spin, hand")
    return Table(title, ("category", "estimator", "n", *_SHOWN, "usable", *errors), rows, 2)


PUBLISHED = {
    "object-prior": ((0.067, 0.182, 0.554), (0.463, 1.0, 1.0), (0.436, 0.840, 0.964), (0.504, 0.831, 0.882)),
    "ee": ((0.961, 0.961, 0.995), (0.951, 0.951, 0.992), (0.219, 0.219, 0.330), (0.674, 0.674, 0.696)),
    "ee-symmetry-prior": ((0.961, 0.961, 0.995), (0.973, 0.974, 0.993), (1.0, 1.0, 1.0), (0.677, 0.677, 0.697)),
    "symmetry-aware": ((0.967, 0.967, 0.994), (0.976, 0.976, 0.997), (1.0, 1.0, 1.0), (0.996, 0.996, 0.999)),
}
"""Table I of the paper, by column: claw, hammer head, screwdriver, wrench, each within 5 deg 2 cm, 5 deg 5 cm and
10 deg 5 cm."""
_PUBLISHED_ROWS = (Category.HAMMER_GRIP, Category.HAMMER_HEAD, Category.SCREWDRIVER_HEAD, Category.WRENCH_HEAD)
_PUBLISHED_THRESHOLDS = ("5deg2cm", "5deg5cm", "10deg5cm")


def table1(groups: dict[str, Any], column: str) -> list[Table]:
    """A column of the paper's Table I, by its own rule, beside the published figures: a table for each threshold.

    Args:
        groups: What `pose.tables` gives for the column's estimator.
        column: Name of the column; "ours" stands beside the paper's best.
    """
    paper = PUBLISHED.get(column, PUBLISHED["symmetry-aware"])
    groups = {group: found["table"] for group, found in groups.items()}
    published: dict[str, Sequence[float]] = {c.value: row for c, row in zip(_PUBLISHED_ROWS, paper, strict=True)}
    published["average"] = np.mean(paper, axis=0).tolist()
    tables = []
    for k, (threshold, limits) in enumerate(
        zip(_PUBLISHED_THRESHOLDS, ("5° 2 cm", "5° 5 cm", "10° 5 cm"), strict=True)
    ):
        rows = []
        for name, figures in published.items():
            shares = [f"{t[name][f'paper_{threshold}']:.3f}" if name in t else "" for t in groups.values()]
            count = sum(t[name]["instances"] for t in groups.values() if name in t)
            rows.append([label_of(name), str(count), *shares, f"{figures[k]:.3f}"])
        tables.append(Table(f"Table I, {column}, true masks, {limits}", ("", "n", *groups, "paper"), rows))
    return tables


def segmentation_tables(found: dict[str, Any]) -> list[Table]:
    """Tables of `toolee evaluate segmentation`, of what `segmentation.report` gives: COCO's statistics [%]."""
    rows = [
        [label_of(name), str(row["instances"]) if "instances" in row else ""]
        + ["–" if row[k] is None else f"{100 * row[k]:.1f}" for k in STATISTICS]
        for name, row in found.items()
        if isinstance(row, dict)
    ]
    return [Table(f"Segmentation, COCO mask AP [%], {found['images']} images", ("class", "n", *STATISTICS), rows)]


def photograph_tables(report: dict[str, Any]) -> list[Table]:
    """Tables of `toolee evaluate photographs`.

    Args:
        report: Its record.

    Returns:
        The ends that are found, their errors beside the annotations' uncertainty, and the false alarms.
    """
    ends, errors, alarms = [], [], []
    for row in report["table"]:
        name = f"{row['half']}, {row['view']}"
        right = f"{row['right']} of {row['known_poses']}" if row["known_poses"] else "–"
        counts = [str(row[k]) for k in ("ends", "found", "certain")]
        ends.append([name, *counts, _number(row["median_score"], 2), str(row["usable"]), right])
        if row["median_mm"] is not None:
            keys = ("median_mm", "median_annotation_mm", "median_deg", "median_annotation_deg")
            errors.append([name, *_numbers(row, keys), str(row["undecided"])])
    for row in [r for r in report["table"] if r["view"] == "whole"] + report["places"]:
        keys = ("empty_frames", "false_alarms", "certain_false_alarms", "frames_with_usable_alarm")
        alarms.append([row["place"] or f"half {row['half']}", *(str(row[k]) for k in keys)])
    heads = ("half, view", "ends", "found", "certain", "median score", "usable", "right pose")
    tables = [Table("End effectors on photographs", heads, ends)]
    if errors:
        columns = ("half, view", "error [mm]", "annotation [mm]", "error [deg]", "annotation [deg]", "undecided")
        tables.append(Table("Medians of errors, and of the annotations' standard deviations", columns, errors))
    where = ("where", "frames", "false alarms", "certain", "frames with a usable one")
    return [*tables, Table("Frames without a tool", where, alarms)]


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None or value != value else f"{value:.{digits}f}"


def _shares(row: dict[str, Any], keys: Sequence[str]) -> list[str]:
    return [_number(row[k], 3) for k in keys]


def _numbers(row: dict[str, Any], keys: Sequence[str]) -> list[str]:
    return [_number(row[k], 1) for k in keys]
