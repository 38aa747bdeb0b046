"""Pictures of an evaluation, as the bytes of PNG files."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import binomtest

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.perception.offline.evaluation.estimates import Estimates

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#12609e", "#d1662b", "#5a8f3c", "#8a5aa8", "#8c8c8c", "#b0902a")
_INK, _GRID = "#22303c", "#e3e8ed"


def accuracy_curves(estimates: dict[str, Estimates], title: str) -> bytes:
    """Share of instances under a threshold over the threshold, as the paper's Fig. 5.

    Args:
        estimates: Label to estimates, one line each.
        title: Title of the picture.

    Returns:
        PNG: rotation above, position below, a column per category.
    """
    present = [i for i in range(len(CATEGORIES)) if any((e.category == i).any() for e in estimates.values())]
    figure, axes = _figure(2, max(len(present), 1), (2.9, 2.5))
    degrees, millimetres = np.linspace(0, 20, 201), np.linspace(0, 30, 201)
    for column, i in enumerate(present):
        for colour, (label, e) in zip(_cycle(len(estimates)), estimates.items(), strict=True):
            own = e.rows(e.category == i)
            if len(own) == 0:
                continue
            axes[0, column].plot(degrees, _share_under(np.rad2deg(own.angle), degrees), color=colour, label=label)
            axes[1, column].plot(millimetres, _share_under(1e3 * own.position, millimetres), color=colour, label=label)
        axes[0, column].set_title(CATEGORIES[i].spec.label, fontsize=10, color=_INK)
        axes[0, column].set_xlabel("rotation threshold [deg]")
        axes[1, column].set_xlabel("position threshold [mm]")
    for row in axes:
        row[0].set_ylabel("share of instances")
        for ax in row:
            ax.set_ylim(0, 1.02)
            ax.set_xlim(left=0)
    return _finish(figure, axes[0, 0], title)


def risk_coverage_curves(reports: dict[str, dict[str, Any]], title: str) -> bytes:
    """Share of failures among the most confident estimates over the share kept.

    Args:
        reports: Label to the result of `pose.confidence`.
        title: Title of the picture.

    Returns:
        PNG.
    """
    figure, axes = _figure(1, 2, (4.2, 3.1))
    for ax, name, text in zip(axes[0], ("10deg2cm", "5deg1cm"), ("10 deg 2 cm", "5 deg 1 cm"), strict=True):
        for colour, (label, report) in zip(_cycle(len(reports)), reports.items(), strict=True):
            curve = report["risk_coverage"][name]
            ax.plot(curve["coverage"], curve["risk"], color=colour, label=label)
        ax.set_title(f"failure: over {text}", fontsize=10, color=_INK)
        ax.set_xlabel("coverage: share of estimates kept")
        ax.set_ylabel("risk: share of failures")
        ax.set_xlim(0, 1)
        ax.set_ylim(bottom=0)
    return _finish(figure, axes[0, 0], title)


def reliability_diagram(reports: dict[str, dict[str, Any]], title: str) -> bytes:
    """Share of successes (10 deg, 2 cm) over the confidence in ten bins, on the diagonal if calibrated.

    Bars: 95 % interval (Wilson); areas: number of estimates.

    Args:
        reports: Label to the result of `pose.confidence`.
        title: Title of the picture.

    Returns:
        PNG.
    """
    figure, axes = _figure(1, 1, (4.4, 3.6))
    ax = axes[0, 0]
    ax.plot([0, 1], [0, 1], color="#9aa7b3", linestyle="--", linewidth=1)
    for colour, (label, report) in zip(_cycle(len(reports)), reports.items(), strict=True):
        confidence, success, count = (np.array(v) for v in zip(*report["reliability"], strict=True))
        chance = [
            binomtest(round(share * n), n).proportion_ci(method="wilson") for _, share, n in report["reliability"]
        ]
        low, high = ([getattr(c, end) for c in chance] for end in ("low", "high"))
        ax.vlines(confidence, low, high, color=colour, linewidth=1.2, zorder=2)
        size = 12 + 120 * count / count.sum()
        ax.scatter(confidence, success, s=size, color=colour, label=label, zorder=3, linewidths=0, clip_on=False)
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1.02)
    ax.set_xlabel("confidence")
    ax.set_ylabel("share within 10 deg and 2 cm")
    return _finish(figure, ax, title)


def sampler_figure(rows: Sequence[dict[str, Any]], title: str) -> bytes:
    """Accuracy over network evaluations, and over time, one point per sampler.

    Args:
        rows: Result of `samplers.sampler_table`.
        title: Title of the picture.

    Returns:
        PNG.
    """
    figure, axes = _figure(1, 2, (4.2, 3.1))
    for ax, key, text in zip(
        axes[0], ("evaluations", "median_ms"), ("network evaluations", "time of sampling one cloud [ms]"), strict=True
    ):
        for row in rows:
            reference = row["sampler"].startswith("RK45")
            y = row["average"]["5deg2cm"]
            ax.scatter(row[key], y, color=_COLOURS[1] if reference else _COLOURS[0], s=34, zorder=3)
            # Only the number of "3 steps": points of few steps lie close together.
            label = row["sampler"].split()[0]
            ax.annotate(label, (row[key], y), textcoords="offset points", xytext=(5, 5), fontsize=8, color=_INK)
        ax.set_xscale("log")
        ax.set_xlabel(text)
        ax.margins(x=0.2, y=0.25)
    axes[0, 0].set_ylabel("average share within 5 deg 2 cm")
    return _finish(figure, None, title)


def _share_under(errors: Any, thresholds: Any) -> Any:
    return np.searchsorted(np.sort(errors), thresholds, side="right") / len(errors)


def _cycle(n: int) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(n)]


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, Any]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(
        rows, columns, figsize=(size[0] * columns, size[1] * rows), squeeze=False, layout="constrained"
    )
    for ax in axes.flat:
        ax.grid(color=_GRID, linewidth=0.8)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=8, colors=_INK)
        ax.xaxis.label.set(size=9, color=_INK)
        ax.yaxis.label.set(size=9, color=_INK)
    return figure, axes


def _finish(figure: Figure, legend_of: Axes | None, title: str) -> bytes:
    from matplotlib import pyplot

    figure.suptitle(title, fontsize=11, color=_INK)
    if legend_of is not None:
        handles, labels = legend_of.get_legend_handles_labels()
        if labels:
            figure.legend(
                handles, labels, loc="outside lower center", ncols=min(len(labels), 5), frameon=False, fontsize=9
            )
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    pyplot.close(figure)
    return buffer.getvalue()
