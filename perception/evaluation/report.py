"""The report of an evaluation: report.json, pictures, and one self-contained report.html."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from toolee_robot.end_effectors import CATEGORIES, label_of
from toolee_robot.perception.evaluation import figures
from toolee_robot.perception.evaluation.html import Page
from toolee_robot.perception.evaluation.metrics import THRESHOLDS
from toolee_robot.perception.evaluation.pose import GROUPS
from toolee_robot.perception.evaluation.run import Evaluation

_NAMES = {
    "5deg2cm": "5° 2 cm", "5deg5cm": "5° 5 cm", "10deg5cm": "10° 5 cm", "10deg2cm": "10° 2 cm",
    "5deg1cm": "5° 1 cm", "5deg5mm": "5° 5 mm", "2deg2mm": "2° 2 mm",
}  # fmt: skip
_MASKS = {"truth": "true masks", "predicted": "predicted masks"}
_PAPER = ("5deg2cm", "5deg5cm", "10deg5cm")
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
    for masks, text in _MASKS.items():
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
        f"{data['left_out_under_50_points']} more are left out, for under 50 of their pixels have a depth. "
        "Single frames; the category's symmetry group alone decides the rotation error."
    )
    for masks, text in _MASKS.items():
        for group in GROUPS:
            found = {
                label: record[masks]["groups"][group]
                for label, record in report["estimators"].items()
                if group in record.get(masks, {}).get("groups", {})
            }
            if found:
                out.section(f"{group.capitalize()} instances, {text}")
                _accuracy(out, found)
                _picture(out, images, f"accuracy_{group}_{masks}.png", "Share of instances under a threshold.")
                _quality(out, found)
                _confidence(out, found)
                _picture(
                    out, images, f"risk_{group}_{masks}.png", "Failures left when the least confident are refused."
                )
                _picture(
                    out,
                    images,
                    f"reliability_{group}_{masks}.png",
                    "Confidence against what became of it; areas: how many; bars: what chance makes of these (95 %).",
                )
    _ranked(out, report)
    _extras(out, report, images)
    out.section("Definitions")
    out.definitions(_DEFINITIONS)
    return out.text()


def _accuracy(out: Page, found: dict[str, Any]) -> None:
    """The paper's Table I: for each category one row an estimator, and the best of each column marked."""
    head = ["category", "estimator", "instances", *(_NAMES[k] for k in THRESHOLDS)]
    head += [f"paper's rule {_NAMES[k]}" for k in _PAPER]
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
            cells = [(_share(row[k]), len(block) > 1 and row[k] == best[k] > 0) for k in THRESHOLDS]
            rule = [_share(t["paper_rule"][category][k]) for k in _PAPER]
            rows.append([label_of(category), label, row["instances"], *cells, *rule])
    out.table(head, rows, starts, left=2)


def _quality(out: Page, found: dict[str, Any]) -> None:
    out.heading("Errors and BOP recall")
    head = ["category", "estimator", "estimated", "median mm", "95 % mm", "median °", "95 % °"]
    head += ["spin °", "spin with hand °", "AR MSSD", "AR MSPD", "AR"]
    rows: list[list[Any]] = []
    for label, t in found.items():
        for category, e in t["errors"].items():
            bop = t["bop"][category]
            numbers = [_number(e[k]) for k in ("median_mm", "p95_mm", "median_deg", "p95_deg")]
            spins = [_number(e[k]) for k in ("spin_median_deg", "spin_with_hand_median_deg")]
            recalls = [_share(bop[k]) for k in ("AR_MSSD", "AR_MSPD", "AR")]
            rows.append([label_of(category), label, _share(e["estimated"]), *numbers, *spins, *recalls])
    out.table(head, rows, left=2)


def _confidence(out: Page, found: dict[str, Any]) -> None:
    out.heading("Confidence and symmetry")
    head = ["estimator", "calibration error", "usable", "right at 10° 2 cm", "right at 5° 1 cm"]
    head += ["failures 10° 2 cm", "worst 10 % refused", "failures 5° 1 cm", "worst 10 % refused"]
    head += ["class symmetry right", "spin observability right"]
    rows = []
    for label, t in found.items():
        c, s = t["confidence"], t["symmetry"]
        symmetry = [_share(s["class_symmetry_accuracy"]), _share(s["spin_observability_accuracy"])]
        if c is None:
            rows.append([label, *["no confidence"] * 1, *["–"] * 7, *symmetry])
            continue
        refused = c["refusing_worst_10_percent"]
        failures = [_share(refused[k][f]) for k in ("10deg2cm", "5deg1cm") for f in ("failures", "failures_kept")]
        right = [_share(c[f"usable_right_{k}"]) for k in ("10deg2cm", "5deg1cm")]
        rows.append(
            [label, _share(c["expected_calibration_error"]), _share(c["usable_share"]), *right, *failures, *symmetry]
        )
    out.table(head, rows)
    out.heading("Errors of confident estimates: the EE's origin and axis (a hammer's face: centre and normal)")
    head = ["category", "estimator", "kept", "share", "centre median mm", "95 % mm", "normal median °", "95 % °"]
    keys = ("centre_median_mm", "centre_p95_mm", "normal_median_deg", "normal_p95_deg")
    kept_rows = [
        [label_of(category), label, name.replace("_percent", " %").replace("_", " "), _share(k["share"])]
        + [_number(k[key]) for key in keys]
        for label, t in found.items()
        if t["confidence"] is not None
        for category, kinds in t["kept"].items()
        for name, k in kinds.items()
        if k["share"] is not None
    ]
    if kept_rows:
        out.table(head, kept_rows, left=3)


def _ranked(out: Page, report: dict[str, Any]) -> None:
    out.section("Score-ranked AP")
    head = ["category", "estimator", "masks", *(_NAMES[k] for k in THRESHOLDS)]
    rows = [
        [label_of(category), label, _MASKS[masks], *(_share(row[k]) for k in THRESHOLDS)]
        for label, record in report["estimators"].items()
        for masks in _MASKS
        if masks in record
        for category, row in record[masks]["ranked_ap"].items()
    ]
    out.table(head, rows, left=3)
    out.section("Usable poses")
    out.paragraph("Results of acting on every usable pose, false alarms included.")
    head = ["estimator", "masks", "poses", "within 10° 2 cm", "wrong ones per image", "end effectors with a right one"]
    rows = [
        [label, _MASKS[masks], u["poses"]]
        + [_share(u[k]) for k in ("right_10deg2cm", "wrong_per_image", "found_10deg2cm")]
        for label, record in report["estimators"].items()
        for masks in _MASKS
        if masks in record
        for u in (record[masks]["usable"],)
    ]
    out.table(head, rows, left=2)


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
    out.cards(
        [(_share(average[k]), f"{text}, average of the {len(CATEGORIES)} categories") for k, text in names.items()]
    )
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
    head = ["sampler", "evaluations", "median ms", "times faster", *(_NAMES[k] for k in THRESHOLDS), "points lost"]
    rows = [
        [r["sampler"], _number(r["evaluations"]), _number(r["median_ms"], 2), _number(r["speed_up"])]
        + [_share(r["average"][k]) for k in THRESHOLDS]
        + [_number(r["5deg2cm_points_lost"])]
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
        rows = [[text, *(_share(f[k][t]) for t in THRESHOLDS), _number(f[k]["median_mm"])] for k, text in names.items()]
        out.table([f"{f['hammers']} hammers", *(_NAMES[k] for k in THRESHOLDS), "median mm"], rows)
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
        for masks in (m for m in _MASKS if m in record):
            t = record[masks]["latency"]
            cells = [label, method["name"], _MASKS[masks], method["candidates"], method["sampler"]]
            times = [_number(t["median_ms"]), _number(t["p90_ms"]), f"{t['device']}, {t['torch_threads']} threads"]
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
    where = f"{label}: {group}, {_MASKS[masks]}"
    cards = [(_share(average[k]), f"{_NAMES[k]}, {where}") for k in ("5deg2cm", "5deg1cm", "5deg5mm")]
    if groups[group]["confidence"] is not None:
        cards.append((_share(groups[group]["confidence"]["expected_calibration_error"]), "calibration error"))
    cards.append((f"{_number(record[masks]['latency']['median_ms'])} ms", "one pose, median"))
    return cards


def _picture(out: Page, images: dict[str, bytes], name: str, caption: str) -> None:
    if name in images:
        out.picture(images[name], caption)


def _share(value: float | None) -> str:
    return "–" if value is None or value != value else f"{value:.3f}"


def _number(value: float | None, digits: int = 1) -> str:
    return "–" if value is None or value != value else f"{value:.{digits}f}"
