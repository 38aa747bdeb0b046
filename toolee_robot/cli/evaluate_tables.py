"""The tables that `toolee evaluate` prints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.table import Table

from toolee_robot.end_effectors import label_of

_SHOWN = ("5deg2cm", "10deg5cm", "5deg1cm", "5deg5mm")
_BREAKDOWN = ("5deg2cm", "5deg1cm", "5deg5mm")
"""Thresholds shown on the terminal; the report has all."""


def text_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> Table:
    """Build a table.

    Args:
        title: Title of the table.
        columns: Headings of the columns.
        rows: Cells of each row.
        left: Number of left-aligned columns.

    Returns:
        The table.
    """
    table = Table(title=title, title_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def pose_tables(report: dict[str, Any]) -> Iterator[Table]:
    """Yield the tables of a report: accuracy per group and kind of masks, and the further evaluations."""
    for masks in ("truth", "predicted"):
        for group in ("held-out", "seen"):
            rows = [
                [label_of(category), label, str(row["instances"]), *(f"{row[k]:.3f}" for k in _SHOWN)]
                for label, record in report["estimators"].items()
                for category, row in _accuracy(record, masks, group).items()
            ]
            if rows:
                title = f"{group} instances, {'true' if masks == 'truth' else masks} masks"
                yield text_table(title, ("category", "estimator", "n", *_SHOWN), rows, left=2)
    for group, found in report.get("exact_shape", {}).items():
        rows = [
            [label_of(category), str(row["instances"]), *(f"{row[k]:.3f}" for k in _SHOWN)]
            for category, row in found.items()
        ]
        yield text_table(f"{group} instances, exact shapes fitted from the true pose", ("category", "n", *_SHOWN), rows)
    label, record = next(iter(report["estimators"].items()))
    masks = "predicted" if "predicted" in record else "truth"
    rows = []
    for axis, groups in record[masks]["breakdown"].items():
        for k, (group, row) in enumerate(groups.items()):
            shares = ["–" if row[key] is None else f"{row[key]:.3f}" for key in _BREAKDOWN]
            rows.append(["" if k else axis, group, str(row["instances"]), str(row["left_out"]), *shares])
    title = f"{label}, {'true' if masks == 'truth' else masks} masks, by what the picture shows"
    yield text_table(title, ("by", "", "n", "no depth", *_BREAKDOWN), rows, left=2)
    if "samplers" in report:
        yield printed_samplers(report["samplers"])
    if "fused" in report:
        fused = report["fused"]
        rows = [
            [name, *(f"{fused[key][k]:.3f}" for k in _SHOWN)]
            for key, name in (("one_frame", "one frame"), ("five_frames", "five views fused"))
        ]
        yield text_table(f"{fused['hammers']} hammers in the hand", ("", *_SHOWN), rows)
    if "no_tool" in report:
        n = report["no_tool"]
        row = [str(n[k]) for k in ("frames", "with_a_detection", "with_a_usable_pose")]
        yield text_table("without a tool", ("frames", "with a detection", "with a usable pose"), [row], left=0)


def printed_samplers(samplers: list[dict[str, Any]]) -> Table:
    """Build the table of the samplers."""
    rows = []
    for r in samplers:
        shares = [f"{r['average'][k]:.3f}" for k in ("5deg2cm", "5deg1cm", "5deg5mm")]
        millimetres = "–" if r["median_mm"] is None else f"{r['median_mm']:.2f}"
        times = [f"{r['evaluations']:.1f}", f"{r['median_ms']:.2f}", f"{r['speed_up']:.1f}"]
        rows.append([r["sampler"], *times, *shares, millimetres])
    head = ("sampler", "evals", "ms", "faster", "5deg2cm", "5deg1cm", "5deg5mm", "median mm")
    return text_table("samplers", head, rows)


def segmentation_rows(found: dict[str, Any]) -> list[list[str]]:
    """Build the rows of the segmentation table: class, instances, COCO's statistics [%]."""
    from toolee_robot.perception.offline.evaluation.segmentation import STATISTICS

    return [
        [label_of(name), str(row.get("instances", ""))]
        + ["–" if row[k] is None else f"{100 * row[k]:.1f}" for k in STATISTICS]
        for name, row in found.items()
        if isinstance(row, dict)
    ]


def _accuracy(record: dict[str, Any], masks: str, group: str) -> dict[str, Any]:
    accuracy: dict[str, Any] = record.get(masks, {}).get("groups", {}).get(group, {}).get("accuracy", {})
    return accuracy


def photograph_tables(report: dict[str, Any]) -> Iterator[Table]:
    """Tables of `toolee evaluate photographs`.

    Args:
        report: Its record.

    Yields:
        The ends that are found, their errors beside the annotations' uncertainty, and the false alarms.
    """
    ends, errors, alarms = [], [], []
    for row in report["table"]:
        score = "-" if row["median_score"] is None else f"{row['median_score']:.2f}"
        right = f"{row['right']} of {row['known_poses']}" if row["known_poses"] else "-"
        counts = [str(row[k]) for k in ("ends", "found", "certain")]
        ends.append([f"{row['half']}, {row['view']}", *counts, score, str(row["usable"]), right])
        if row["median_mm"] is not None:
            annotated = [_or_dash(row[f"median_{k}"]) for k in ("mm", "annotation_mm", "deg", "annotation_deg")]
            errors.append([f"{row['half']}, {row['view']}", *annotated, str(row["undecided"])])
    for row in [r for r in report["table"] if r["view"] == "whole"] + report["places"]:
        keys = ("empty_frames", "false_alarms", "certain_false_alarms", "frames_with_usable_alarm")
        alarms.append([row["place"] or f"half {row['half']}", *[str(row[k]) for k in keys]])
    columns = ("half, view", "ends", "found", "certain", "median score", "usable", "right pose")
    yield text_table("End effectors on photographs", columns, ends)
    if errors:
        heads = ("half, view", "error [mm]", "annotation [mm]", "error [deg]", "annotation [deg]", "undecided")
        yield text_table("Medians of errors, and of the annotations' standard deviations", heads, errors)
    yield text_table(
        "Frames without a tool", ("where", "frames", "false alarms", "certain", "frames with a usable one"), alarms
    )


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
