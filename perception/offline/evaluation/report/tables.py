"""The tables of the HTML report of a pose evaluation."""

from __future__ import annotations

from typing import Any

from toolee_robot.end_effectors import label_of
from toolee_robot.perception.offline.evaluation.metrics import THRESHOLDS
from toolee_robot.runtime.html_page import Page

NAMES = {
    "5deg2cm": "5° 2 cm", "5deg5cm": "5° 5 cm", "10deg5cm": "10° 5 cm", "10deg2cm": "10° 2 cm",
    "5deg1cm": "5° 1 cm", "5deg5mm": "5° 5 mm", "2deg2mm": "2° 2 mm",
}  # fmt: skip
"""Column headings of `THRESHOLDS`."""
MASKS = {"truth": "true masks", "predicted": "predicted masks"}
"""Texts of the kinds of masks."""
_PAPER = ("5deg2cm", "5deg5cm", "10deg5cm")
"""The paper's thresholds."""


def accuracy_table(out: Page, found: dict[str, Any]) -> None:
    """Add the paper's Table I: for each category one row per estimator, the best of each column marked.

    Args:
        out: The page.
        found: Label of an estimator to its result of `pose.tables` for one group.
    """
    head = ["category", "estimator", "instances", *(NAMES[k] for k in THRESHOLDS)]
    head += [f"paper's rule {NAMES[k]}" for k in _PAPER]
    rows: list[list[Any]] = []
    starts = set()
    categories = list(dict.fromkeys(c for tables in found.values() for c in tables["accuracy"]))
    categories.sort(key="average".__eq__)
    for category in categories:
        block = {label: t for label, t in found.items() if category in t["accuracy"]}
        best = {k: max(t["accuracy"][category][k] for t in block.values()) for k in THRESHOLDS}
        for label, t in block.items():
            if label == next(iter(block)):
                starts.add(len(rows))
            row = t["accuracy"][category]
            cells = [(format_share(row[k]), len(block) > 1 and row[k] == best[k] > 0) for k in THRESHOLDS]
            rule = [format_share(t["paper_rule"][category][k]) for k in _PAPER]
            rows.append([label_of(category), label, row["instances"], *cells, *rule])
    out.table(head, rows, starts, left=2)


def error_table(out: Page, found: dict[str, Any]) -> None:
    """Add errors and BOP recall, for each category one row per estimator.

    Args:
        out: The page.
        found: As in `accuracy_table`.
    """
    out.heading("Errors and BOP recall")
    head = ["category", "estimator", "estimated", "median mm", "95 % mm", "median °", "95 % °"]
    head += ["spin °", "spin with hand °", "AR MSSD", "AR MSPD", "AR"]
    rows: list[list[Any]] = []
    for label, t in found.items():
        for category, e in t["errors"].items():
            bop = t["bop"][category]
            numbers = [format_number(e[k]) for k in ("median_mm", "p95_mm", "median_deg", "p95_deg")]
            spins = [format_number(e[k]) for k in ("spin_median_deg", "spin_with_hand_median_deg")]
            recalls = [format_share(bop[k]) for k in ("AR_MSSD", "AR_MSPD", "AR")]
            rows.append([label_of(category), label, format_share(e["estimated"]), *numbers, *spins, *recalls])
    out.table(head, rows, left=2)


def confidence_tables(out: Page, found: dict[str, Any]) -> None:
    """Add calibration and usefulness of the confidence, symmetry, and errors of confident estimates.

    Args:
        out: The page.
        found: As in `accuracy_table`.
    """
    out.heading("Confidence and symmetry")
    head = ["estimator", "calibration error", "usable", "right at 10° 2 cm", "right at 5° 1 cm"]
    head += ["failures 10° 2 cm", "worst 10 % refused", "failures 5° 1 cm", "worst 10 % refused"]
    head += ["class symmetry right", "spin observability right"]
    rows = []
    for label, t in found.items():
        c, s = t["confidence"], t["symmetry"]
        symmetry = [format_share(s["class_symmetry_accuracy"]), format_share(s["spin_observability_accuracy"])]
        if c is None:
            rows.append([label, *["no confidence"] * 1, *["–"] * 7, *symmetry])
            continue
        refused = c["refusing_worst_10_percent"]
        failures = [format_share(refused[k][f]) for k in ("10deg2cm", "5deg1cm") for f in ("failures", "failures_kept")]
        right = [format_share(c[f"usable_right_{k}"]) for k in ("10deg2cm", "5deg1cm")]
        rows.append(
            [
                label,
                format_share(c["expected_calibration_error"]),
                format_share(c["usable_share"]),
                *right,
                *failures,
                *symmetry,
            ]
        )
    out.table(head, rows)
    out.heading("Errors of confident estimates: the EE's origin and axis (a hammer's face: centre and normal)")
    head = ["category", "estimator", "kept", "share", "centre median mm", "95 % mm", "normal median °", "95 % °"]
    keys = ("centre_median_mm", "centre_p95_mm", "normal_median_deg", "normal_p95_deg")
    kept_rows = [
        [label_of(category), label, name.replace("_percent", " %").replace("_", " "), format_share(k["share"])]
        + [format_number(k[key]) for key in keys]
        for label, t in found.items()
        if t["confidence"] is not None
        for category, kinds in t["kept"].items()
        for name, k in kinds.items()
        if k["share"] is not None
    ]
    if kept_rows:
        out.table(head, kept_rows, left=3)


def ranking_tables(out: Page, report: dict[str, Any]) -> None:
    """Add AP of the ranked poses, and the usable poses.

    Args:
        out: The page.
        report: Contents of report.json.
    """
    out.section("Score-ranked AP")
    head = ["category", "estimator", "masks", *(NAMES[k] for k in THRESHOLDS)]
    rows = [
        [label_of(category), label, MASKS[masks], *(format_share(row[k]) for k in THRESHOLDS)]
        for label, record in report["estimators"].items()
        for masks in MASKS
        if masks in record
        for category, row in record[masks]["ranked_ap"].items()
    ]
    out.table(head, rows, left=3)
    out.section("Usable poses")
    out.paragraph("Results of acting on every usable pose, false alarms included.")
    head = ["estimator", "masks", "poses", "within 10° 2 cm", "wrong ones per image", "end effectors with a right one"]
    rows = [
        [label, MASKS[masks], u["poses"]]
        + [format_share(u[k]) for k in ("right_10deg2cm", "wrong_per_image", "found_10deg2cm")]
        for label, record in report["estimators"].items()
        for masks in MASKS
        if masks in record
        for u in (record[masks]["usable"],)
    ]
    out.table(head, rows, left=2)


def breakdown_table(out: Page, found: dict[str, dict[str, Any]]) -> None:
    """Add the accuracy by what the pictures show.

    Args:
        out: The page.
        found: Label of an estimator to its `breakdown` under one kind of masks.
    """
    out.heading("By what the picture shows")
    head = ["by", "", "estimator", "instances", "left out for want of depth", "estimated"]
    rows: list[list[Any]] = []
    starts = set()
    for axis in next(iter(found.values())):
        starts.add(len(rows))
        for label, tables in found.items():
            for group, row in tables[axis].items():
                counts = [row["instances"], row["left_out"], format_share(row["estimated"])]
                rows.append([axis, group, label, *counts, *(format_share(row[k]) for k in THRESHOLDS)])
    out.table([*head, *(NAMES[k] for k in THRESHOLDS)], rows, starts, left=3)


def format_share(value: float | None) -> str:
    """Three decimals; a dash for None or NaN."""
    return "–" if value is None or value != value else f"{value:.3f}"


def format_number(value: float | None, digits: int = 1) -> str:
    """Format a number.

    Args:
        value: The number.
        digits: Number of decimals.

    Returns:
        Its text; a dash for None or NaN.
    """
    return "–" if value is None or value != value else f"{value:.{digits}f}"
