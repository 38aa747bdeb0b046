"""Figures of a data set: its distributions, and the shape distances of the paper's Fig. 3."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.perception.offline.dataset.figures.shape_distances import MEASURES, VIEWS, ShapeDistances

_NAMES = {
    "depth_m": "depth of the EE [m]",
    "hidden_share": "share of the EE hidden",
    "visible_pixels": "visible pixels (log)",
    "points_with_depth": "pixels with a depth (log)",
    "view_angle_deg": "EE's z axis to camera [deg]",
    "in_image_angle_deg": "tool's axis in the image [deg], 0: up",
    "tool_off_vertical_deg": "tool's axis off the image's up [deg]",
}
_TITLES = {"chamfer": "Chamfer", "hausdorff": "Hausdorff", "earth_mover": "Earth-Mover's"}


def distributions(card: dict[str, Any]) -> Figure:
    """The histograms of a data card: filled for the training split, outlined for the test split, by category."""
    figure = Figure(figsize=(15, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 4).ravel()
    for ax, (name, title) in zip(axes, _NAMES.items(), strict=False):
        edges = np.asarray(card["histogram_edges"][name], float)
        at = np.arange(len(edges), dtype=float) if "log" in title else edges
        width = np.diff(at)
        bottom = np.zeros(len(width))
        train = [_counts(card, "train", c, name) for c in map(str, CATEGORIES)]
        total = max(sum(h.sum() for h in train), 1.0)
        for c, h in zip(CATEGORIES, train, strict=True):
            ax.bar(at[:-1], h / total, width, bottom, align="edge", color=c.spec.color, label=c.spec.label)
            bottom += h / total
        test = np.sum([_counts(card, "test", c, name) for c in map(str, CATEGORIES)], axis=0)
        if test.sum():
            ax.stairs(test / test.sum(), at, color="black", linewidth=1.5, label="test, all")
        if "log" in title:
            ax.set_xticks(at[::2], [f"{e:g}" for e in edges[::2]])
        ax.set_xlabel(title)
        ax.set_ylabel("share of the targets")
        ax.set_xlim(at[0], at[-1])
    _counts_chart(axes[-1], card)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    spec = card["spec"]
    figure.suptitle(
        f"{spec['config']}, {spec['size']} examples, seed {spec['seed']}: end effectors to be found", fontsize=11
    )
    return figure


def _counts_chart(ax: Any, card: dict[str, Any]) -> None:
    """Targets and instances, by category."""
    y = np.arange(len(CATEGORIES))
    for split, offset, alpha in (("train", 0.2, 1.0), ("test", -0.2, 0.5)):
        about = [card["splits"][split]["categories"][str(c)] for c in CATEGORIES]
        bars = ax.barh(
            y + offset, [a["targets"] for a in about], 0.38, color=[c.spec.color for c in CATEGORIES], alpha=alpha
        )
        ax.bar_label(bars, [f" {split}: {a['targets']}, {len(a['instances'])} tools" for a in about], fontsize=8)
    ax.set_yticks(y, [c.spec.label.replace(" ", "\n") for c in CATEGORIES])
    ax.margins(x=0.6)
    ax.set_xlabel("targets (and instances)")


def _counts(card: dict[str, Any], split: str, category: str, name: str) -> Any:
    return np.asarray(card["splits"][split]["categories"][category]["histograms"][name], float)


def shape_figure(shapes: ShapeDistances) -> Figure:
    """Fig. 3: distances within each category, object-centric against EE-centric: boxes, means as diamonds."""
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(MEASURES))
    names = list(shapes.values)
    for ax, measure in zip(axes, MEASURES, strict=True):
        for view, offset, color in zip(VIEWS, (-0.2, 0.2), ("0.65", "tab:green"), strict=True):
            boxes = ax.boxplot(
                [shapes.values[n][view][measure] for n in names],
                positions=np.arange(len(names)) + offset,
                widths=0.34,
                patch_artist=True,
                showmeans=True,
                flierprops={"markersize": 2},
                medianprops={"color": "black"},
                meanprops={"marker": "D", "markerfacecolor": "white", "markeredgecolor": "black", "markersize": 4},
            )
            for box in boxes["boxes"]:
                box.set_facecolor(color)
        ax.set_xticks(np.arange(len(names)), [n.replace("_", "\n") for n in names])
        ax.set_title(f"{_TITLES[measure]} distance [mm]", fontsize=10)
        ax.set_ylim(bottom=0)
    axes[0].legend([_patch("0.65"), _patch("tab:green")], ["object-centric", "EE-centric"], frameon=False)
    return figure


def _patch(color: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=color, edgecolor="black")
