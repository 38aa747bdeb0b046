"""The report of an evaluation: report.json, pictures, and one self-contained report.html."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from toolee_robot.end_effectors import CATEGORIES, label_of
from toolee_robot.perception.offline.evaluation.metrics import THRESHOLDS
from toolee_robot.perception.offline.evaluation.pose import GROUPS
from toolee_robot.perception.offline.evaluation.report import figures
from toolee_robot.perception.offline.evaluation.report.tables import (
    MASKS,
    NAMES,
    accuracy_table,
    breakdown_table,
    confidence_tables,
    error_table,
    format_number,
    format_share,
    ranking_tables,
)
from toolee_robot.perception.offline.evaluation.run import Evaluation
from toolee_robot.runtime.html_page import Page

_DEFINITIONS = {
    "n° m cm": "share of instances whose rotation error, modulo the category's symmetry group, and position error are "
    "both under the threshold; an instance without an estimate counts as over it",
    "paper's rule": "the same with the paper's rotation error, which ignores axes that the prediction itself calls "
    "ambiguous; only for comparison with its tables",
    "AR MSSD, MSPD": "BOP's average recall of the maximum symmetry-aware surface distance (0.05 to 0.5 of the EE's "
    "diameter) and projection distance (5 to 50 px at a width of 640)",
    "ranked AP": "area under the precision-recall curve of detections ranked by trust, right "
    "if their box overlaps the EE's (IoU over 0.1) and the pose is under the threshold (NOCS)",
    "held-out, seen": "tools that were not, and that were, in the training data; both in new images",
    "usable": "the estimate's confidence is over the threshold that was fixed after training",
    "calibration error": "mean gap between confidence and share within 10 deg and 2 cm over ten bins",
    "risk, coverage": "share of failures among the estimates kept; share of estimates kept",
}


def pictures(evaluation: Evaluation) -> dict[str, bytes]:
    """The pictures of an evaluation: file name to PNG."""
    made: dict[str, bytes] = {}
    estimators = evaluation.report["estimators"]
    for masks, text in MASKS.items():
        for group in GROUPS:
            rows = {
                label: e.rows(e.held_out if group == "held-out" else ~e.held_out)
                for label, by_masks in evaluation.estimates.items()
                if (e := by_masks.get(masks)) is not None
            }
            rows = {label: e for label, e in rows.items() if len(e)}
            if rows:
                title = f"Accuracy over thresholds: {group} instances, {text}"
                made[f"accuracy_{group}_{masks}.png"] = figures.accuracy_curves(rows, title)
            worth = {
                label: report
                for label, record in estimators.items()
                if (report := record.get(masks, {}).get("groups", {}).get(group, {}).get("confidence")) is not None
            }
            if worth:
                title = f"Confidence: {group} instances, {text}"
                made[f"risk_{group}_{masks}.png"] = figures.risk_coverage_curves(worth, title)
                made[f"reliability_{group}_{masks}.png"] = figures.reliability_diagram(worth, title)
    if "samplers" in evaluation.report:
        made["samplers.png"] = figures.sampler_figure(evaluation.report["samplers"], "Samplers, one cloud at a time")
    return made


def page(evaluation: Evaluation, images: dict[str, bytes], subtitle: str) -> str:
    """The HTML report.

    Args:
        evaluation: The evaluation.
        images: Its pictures, file name to PNG.
        subtitle: Line below the title.

    Returns:
        The page.
    """
    report = evaluation.report
    data = report["data"]
    out = Page("TOOLEE benchmark: 6D pose of tool end effectors", subtitle)
    out.cards(_headline(report))
    out.paragraph(
        f"{data['images']} images of the data set “{data['folder']}”, {data['targets']} end effectors asked for, "
        f"{data['targets_held_out']} of them on {data['held_out_tools']} held-out tools. "
        f"{data['left_out_under_50_points']} more are left out because fewer than 50 of their pixels have a depth. "
        "Single frames; rotation errors are modulo the category's symmetry group."
    )
    for masks, text in MASKS.items():
        for group in GROUPS:
            found = {
                label: record[masks]["groups"][group]
                for label, record in report["estimators"].items()
                if group in record.get(masks, {}).get("groups", {})
            }
            if found:
                out.section(f"{group.capitalize()} instances, {text}")
                accuracy_table(out, found)
                _picture(out, images, f"accuracy_{group}_{masks}.png", "Share of instances under a threshold.")
                error_table(out, found)
                if group == "held-out":
                    breakdown_table(out, {k: r[masks]["breakdown"] for k, r in report["estimators"].items()})
                confidence_tables(out, found)
                _picture(
                    out, images, f"risk_{group}_{masks}.png", "Failures left when the least confident are refused."
                )
                _picture(
                    out,
                    images,
                    f"reliability_{group}_{masks}.png",
                    "Share of successes over the confidence; areas: number of estimates; bars: 95 % interval.",
                )
    ranking_tables(out, report)
    _extras(out, report, images)
    out.section("Definitions")
    out.definitions(_DEFINITIONS)
    return out.text()


def sampler_page(rows: list[dict[str, Any]], images: dict[str, bytes], subtitle: str) -> str:
    """The HTML report of the samplers alone.

    Args:
        rows: Result of `samplers.sampler_table`.
        images: Pictures, file name to PNG.
        subtitle: Line below the title.

    Returns:
        The page.
    """
    out = Page("TOOLEE benchmark: samplers", subtitle)
    _samplers(out, rows, images)
    return out.text()


def segmentation_page(found: dict[str, Any], rows: list[list[str]], columns: Sequence[str], subtitle: str) -> str:
    """The HTML report of the segmentation.

    Args:
        found: Result of `segmentation.report`.
        rows: Its rows as text.
        columns: Headings of the statistics.
        subtitle: Line below the title.

    Returns:
        The page.
    """
    out = Page("TOOLEE benchmark: segmentation", subtitle)
    average = found["average"]
    names = {"AP": "AP", "AP50": "AP50", "AP75": "AP75"}
    over = f"average of the {len(CATEGORIES)} categories"
    out.cards([(format_share(average[k]), f"{text}, {over}") for k, text in names.items()])
    out.section("COCO mask AP")
    out.table(["class", "instances", *columns], rows)
    out.paragraph(
        f"{found['images']} images; AP in percent, the mean over IoU .50 to .95, at .50, at .75, and for areas under "
        "32², to 96² and over [px]. Instances of under 50 visible pixels are neither found nor missed; in the average "
        "of targets neither are those of which more than 70 % is hidden, or that are not 0.4 to 1.1 m away."
    )
    return out.text()


def _samplers(out: Page, samplers: list[dict[str, Any]], images: dict[str, bytes]) -> None:
    out.section("Samplers")
    head = ["sampler", "evaluations", "median ms", "times faster", *(NAMES[k] for k in THRESHOLDS), "points lost"]
    rows = [
        [r["sampler"], format_number(r["evaluations"]), format_number(r["median_ms"], 2), format_number(r["speed_up"])]
        + [format_share(r["average"][k]) for k in THRESHOLDS]
        + [format_number(r["5deg2cm_points_lost"])]
        for r in samplers
    ]
    out.table(head, rows)
    out.paragraph(f"{samplers[0]['clouds']} clouds under true masks; points lost at 5° 2 cm against RK45, in percent.")
    _picture(out, images, "samplers.png", "Every sampler on the same network, the same clouds and the same noise.")


def _extras(out: Page, report: dict[str, Any], images: dict[str, bytes]) -> None:
    if "samplers" in report:
        _samplers(out, report["samplers"], images)
    if "fused" in report:
        f = report["fused"]
        out.section("Five views fused")
        names = {"one_frame": "one frame", "five_frames": "five frames"}
        rows = [
            [text, *(format_share(f[k][t]) for t in THRESHOLDS), format_number(f[k]["median_mm"])]
            for k, text in names.items()
        ]
        out.table([f"{f['hammers']} hammers", *(NAMES[k] for k in THRESHOLDS), "median mm"], rows)
    for group, found in report.get("exact_shape", {}).items():
        out.section(f"{group.capitalize()} instances, exact shapes")
        rows = [
            [
                label_of(category),
                row["instances"],
                *(format_share(row[t]) for t in THRESHOLDS),
                *(format_number(row[median], 2) for median in ("median_mm", "median_deg")),
            ]
            for category, row in found.items()
        ]
        out.table(["category", "instances", *(NAMES[k] for k in THRESHOLDS), "median mm", "median °"], rows)
        out.paragraph(
            "Each tool's exact shape, fitted to its cloud from the true pose: what the depth images allow. No "
            "estimator has this shape, or this beginning."
        )
    if "no_tool" in report:
        n = report["no_tool"]
        out.section("Frames without a tool")
        out.paragraph(
            f"{n['with_a_usable_pose']} of {n['frames']} cluttered frames without a tool gave a usable pose; "
            f"{n['with_a_detection']} gave a detection."
        )
    out.section("Latency")
    rows = []
    for label, record in report["estimators"].items():
        method = record["method"]
        for masks in (m for m in MASKS if m in record):
            t = record[masks]["latency"]
            cells = [label, method["name"], MASKS[masks], method["candidates"], method["sampler"]]
            times = [
                format_number(t["median_ms"]),
                format_number(t["p90_ms"]),
                f"{t['device']}, {t['torch_threads']} threads",
            ]
            rows.append([*cells, *times])
    out.table(["estimator", "method", "masks", "K", "sampler", "median ms", "90 % ms", "on"], rows, left=3)


def _headline(report: dict[str, Any]) -> list[tuple[str, str]]:
    label, record = next(iter(report["estimators"].items()))
    masks = "predicted" if "predicted" in record else "truth"
    groups = record[masks]["groups"]
    group = "held-out" if "held-out" in groups else "seen"
    if group not in groups:
        return []
    average = groups[group]["accuracy"]["average"]
    where = f"{label}: {group}, {MASKS[masks]}"
    cards = [(format_share(average[k]), f"{NAMES[k]}, {where}") for k in ("5deg2cm", "5deg1cm", "5deg5mm")]
    if groups[group]["confidence"] is not None:
        cards.append((format_share(groups[group]["confidence"]["expected_calibration_error"]), "calibration error"))
    cards.append((f"{format_number(record[masks]['latency']['median_ms'])} ms", "one pose, median"))
    return cards


def _picture(out: Page, images: dict[str, bytes], name: str, caption: str) -> None:
    if name in images:
        out.picture(images[name], caption)
