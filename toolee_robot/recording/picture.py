"""The picture of a job: the camera's image, the estimated pose, and the nail's protrusion."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, transform, transform_points
from toolee_robot.runtime.pose_text import sigma_text
from toolee_robot.types import CameraIntrinsics, RgbdFrame, ToolEstimate

_INK, _MUTED, _GRID = "#1f2933", "#6b7785", "#e3e8ee"
_AXES = ("#e5383b", "#2a9d3f", "#1d6fd8")  # x, y, z
_AXIS_LENGTH = 0.03
"""Length of the drawn EE axes [m]."""
_AZIMUTH = -68.0
"""Azimuth of the cloud's viewpoint [deg]; -90 is the camera's own view."""


@dataclass(frozen=True)
class NailCurve:
    """The nail's protrusion as the robot measured it.

    Attributes:
        protrusion_mm: Protrusion over the wood before the first strike and after each strike [mm]; None where it was
            not measured.
        flush_mm: Largest protrusion that counts as flush [mm].
        name: Name of the nail, which is shown where there are several.
    """

    protrusion_mm: tuple[float | None, ...]
    flush_mm: float
    name: str = ""


def draw(
    frame: RgbdFrame | None,
    estimates: Sequence[ToolEstimate],
    nails: Sequence[NailCurve] = (),
    *,
    title: str = "",
    note: str = "",
    focus: Category | None = None,
) -> bytes:
    """Draw the picture: image with masks and axes, point cloud with the candidate poses, and the nail.

    The cloud's panel shows the best usable estimate, or else the best; the image's panel shows every detection.

    Args:
        frame: The frame; None if no image was taken.
        estimates: Estimates from the frame.
        nails: Course of each nail's protrusion, in order; empty for no such panel.
        title: Title of the picture.
        note: Text at its upper right corner.
        focus: Category preferred for the cloud's panel.

    Returns:
        The picture as PNG.
    """
    best = max(estimates, key=lambda e: (e.category == focus, e.usable, e.confidence), default=None)
    panels = 2 + bool(nails)
    with mpl.rc_context({"font.family": "DejaVu Sans", "font.size": 10.5, "text.color": _INK, "axes.labelcolor": _INK}):
        figure = Figure(figsize=(5.6 * panels, 5.9), dpi=110, facecolor="white")
        grid = figure.add_gridspec(1, panels, left=0.012, right=0.985, bottom=0.10, top=0.845, wspace=0.06)
        if title:
            figure.text(0.012, 0.955, title, fontsize=15, fontweight="bold", va="center")
        if note:
            figure.text(0.988, 0.955, note, fontsize=10.5, color=_MUTED, va="center", ha="right")
        if frame is None:
            _heading(figure, grid[0], "What the camera sees", "no image was taken")
        else:
            _draw_rgb(figure, grid[0], frame, estimates, best)
            _draw_cloud(figure, grid[1], frame, best)
        if nails:
            _draw_nails(figure, grid[2], nails)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _heading(figure: Figure, panel: SubplotSpec, text: str, detail: str = "") -> None:
    """Head and foot of a panel, on common lines whatever the panel holds."""
    left = panel.get_position(figure).x0
    figure.text(left, 0.885, text, fontsize=12, fontweight="bold", va="center")
    if detail:
        figure.text(left, 0.055, detail, fontsize=9.5, color=_MUTED, va="center")


def _project(intrinsics: CameraIntrinsics, points: Array) -> Array:
    """Pixels (N, 2) of points (N, 3) in the camera frame."""
    uvw = points @ intrinsics.matrix.T
    return uvw[:, :2] / uvw[:, 2:]


def _overlay(rgb: NDArray[np.uint8], estimates: Sequence[ToolEstimate]) -> NDArray[np.uint8]:
    """The image with the masks tinted in their category's colour."""
    image = rgb.astype(np.float32)
    for e in estimates:
        colour = np.array([int(e.category.spec.color[i : i + 2], 16) for i in (1, 3, 5)], dtype=np.float32)
        image[e.detection.mask] = 0.5 * image[e.detection.mask] + 0.5 * colour
    return image.astype(np.uint8)


def _draw_estimate(ax: Any, frame: RgbdFrame, e: ToolEstimate, *, weight: float) -> None:
    """Outline, box and EE axes of one estimate, in image coordinates."""
    contours, _ = cv2.findContours(e.detection.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for c in contours:
        closed = np.vstack([c[:, 0], c[:1, 0]])
        ax.plot(closed[:, 0], closed[:, 1], color=e.category.spec.color, lw=0.7 * weight)
    x0, y0, x1, y1 = e.detection.box
    ax.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, ec=e.category.spec.color, lw=0.8 * weight))
    if not e.usable:
        return
    tips = e.X_camera_ee[:3, 3] + _AXIS_LENGTH * np.vstack([np.zeros(3), e.X_camera_ee[:3, :3].T])
    if np.any(tips[:, 2] < 0.05):
        return
    uv = _project(frame.intrinsics, tips)
    for i in range(3):
        ax.plot(uv[[0, i + 1], 0], uv[[0, i + 1], 1], color="white", lw=1.6 * weight, solid_capstyle="round")
        ax.plot(uv[[0, i + 1], 0], uv[[0, i + 1], 1], color=_AXES[i], lw=weight, solid_capstyle="round")


def _draw_rgb(
    figure: Figure, panel: SubplotSpec, frame: RgbdFrame, estimates: Sequence[ToolEstimate], best: ToolEstimate | None
) -> None:
    seen = {e.category: e.detection.score for e in sorted(estimates, key=lambda e: e.detection.score)}
    text = "   ".join(f"{c.label} {s:.2f}" for c, s in seen.items()) or "no end effector found"
    _heading(figure, panel, "What the camera sees", f"detection scores: {text}" if seen else text)
    image = _overlay(frame.rgb, estimates)
    h, w = image.shape[:2]
    ax = figure.add_subplot(panel)
    ax.imshow(image, interpolation="lanczos")
    ax.set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), xticks=[], yticks=[])
    ax.set_anchor("NW")
    for spine in ax.spines.values():
        spine.set_visible(False)
    for e in estimates:
        _draw_estimate(ax, frame, e, weight=1.6)
    if best is None:
        return
    # A close look at the end effector, in the corner farthest from it.
    x0, y0, x1, y1 = best.detection.box
    u, v, half = (x0 + x1) / 2, (y0 + y1) / 2, max(0.85 * max(x1 - x0, y1 - y0), 14.0)
    left = 1.0 - 0.42 * h / w if u < w / 2 else 0.0
    bottom = 0.58 if v > h / 2 else 0.0
    zoom = ax.inset_axes((left, bottom, 0.42 * h / w, 0.42))
    zoom.imshow(image, interpolation="nearest")
    zoom.set(xlim=(u - half, u + half), ylim=(v + half, v - half), xticks=[], yticks=[])
    _draw_estimate(zoom, frame, best, weight=2.6)
    for spine in zoom.spines.values():
        spine.set(color="white", linewidth=2)


def _draw_cloud(figure: Figure, panel: SubplotSpec, frame: RgbdFrame, best: ToolEstimate | None) -> None:
    if best is None or best.hypotheses is None or not np.all(np.isfinite(best.X_camera_ee)):
        why = "no end effector found" if best is None else "no cloud was kept" if best.usable else best.reason
        _heading(figure, panel, "The end effector's cloud", f"nothing to show: {why}")
        return
    hypotheses = best.hypotheses
    sigma = sigma_text(best.covariance, best.X_camera_ee)
    _heading(
        figure,
        panel,
        f"{len(hypotheses.points)} points, {len(hypotheses.Xs_camera_ee)} candidates, one pose",
        f"{best.category.label}: {sigma}   confidence {best.confidence:.2f}",
    )
    ax: Any = figure.add_subplot(panel, projection="3d")
    # Shown as the camera sees it (right, away, up), turned a little so that depth can be read; [mm] about the EE.
    R_view_camera = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    X_view_camera = transform(R_view_camera, -R_view_camera @ best.X_camera_ee[:3, 3])
    points = transform_points(X_view_camera, hypotheses.points) * 1e3
    uv = np.round(_project(frame.intrinsics, hypotheses.points)).astype(int)
    h, w = frame.rgb.shape[:2]
    colours = frame.rgb[np.clip(uv[:, 1], 0, h - 1), np.clip(uv[:, 0], 0, w - 1)] / 255.0
    ax.scatter(*points.T, s=6, c=0.85 * colours, alpha=0.8, linewidths=0, depthshade=False)

    length = _AXIS_LENGTH * 1e3
    Xs = X_view_camera @ hypotheses.Xs_camera_ee
    for i in range(3):
        for X in Xs:
            origin = X[:3, 3] * 1e3
            ax.plot(
                *np.stack([origin, origin + 0.9 * length * X[:3, i]]).T,
                color=_AXES[i], lw=0.8, alpha=0.35 if i == 2 else 0.16,
            )  # fmt: skip
    tips = 1.2 * length * (X_view_camera @ best.X_camera_ee)[:3, :3].T
    for tip, name, colour in zip(tips, "xyz", _AXES, strict=True):
        ax.plot(*np.stack([np.zeros(3), tip]).T, color=colour, lw=3.4, solid_capstyle="round")
        ax.text(*(1.16 * tip), name, color=colour, fontsize=12, fontweight="bold", ha="center", va="center")

    low = np.vstack([np.percentile(points, 0.5, axis=0), 1.2 * tips]).min(axis=0)
    high = np.vstack([np.percentile(points, 99.5, axis=0), 1.2 * tips]).max(axis=0)
    middle, radius = (low + high) / 2, max(float((high - low).max()) / 2, 20.0) * 1.02
    right = np.array([-np.sin(np.deg2rad(_AZIMUTH)), np.cos(np.deg2rad(_AZIMUTH)), 0.0])  # of the view: true length
    bar = middle + np.array([0.0, 0.0, -1.12 * radius]) + np.outer([-5.0, 5.0], right)
    ax.plot(*bar.T, color=_INK, lw=2.2)
    ax.text(
        *(bar.mean(axis=0) - [0.0, 0.0, 0.09 * radius]), "10 mm", fontsize=9, color=_MUTED, ha="center", va="center"
    )
    limits = np.stack([middle - radius, middle + radius]).T
    ax.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    ax.set_box_aspect((1, 1, 1), zoom=1.4)
    ax.set_proj_type("ortho")
    ax.view_init(elev=16.0, azim=_AZIMUTH)
    ax.set_axis_off()


def _draw_nails(figure: Figure, panel: SubplotSpec, nails: Sequence[NailCurve]) -> None:
    several = len(nails) > 1
    _heading(figure, panel, f"The nail{'s' if several else ''}, as the robot measures {'them' if several else 'it'}")
    ax = figure.add_subplot(panel)
    top = max((value for nail in nails for value in nail.protrusion_mm if value is not None), default=1.0)
    top = max(top, 1.0) * 1.12
    bottom = -0.14 * top
    ax.axhspan(bottom, 0.0, color="#d9b48a", lw=0)
    ax.text(0.985, bottom / 2, "wood", transform=ax.get_yaxis_transform(), color="#7a5526", ha="right", va="center")
    ax.axhline(nails[0].flush_mm, color="#2a9d3f", lw=1.4, ls=(0, (5, 3)))
    ax.text(
        0.015, bottom / 2, f"- -  flush: {nails[0].flush_mm:g} mm or less", transform=ax.get_yaxis_transform(),
        color="#14632a", ha="left", va="center",
    )  # fmt: skip
    first = 0
    for nail in nails:
        known = [(first + strike, value) for strike, value in enumerate(nail.protrusion_mm) if value is not None]
        strikes, values = [strike for strike, _ in known], [value for _, value in known]
        ax.vlines(strikes, 0.0, values, color="#9aa5b1", lw=2.2, zorder=2)
        ax.plot(strikes, values, color=_AXES[2], lw=1.2, alpha=0.5, zorder=3)
        ax.scatter(strikes, values, s=44, color=_AXES[2], zorder=4, edgecolors="white", linewidths=1)
        for i in {0, len(values) - 1} if values else set[int]():
            ax.annotate(
                f"{values[i]:z.1f}" + (f"\n{nail.name}" if several and i == 0 else ""), (strikes[i], values[i]),
                xytext=(0, 9), textcoords="offset points", ha="center", fontweight="bold",
            )  # fmt: skip
        first += len(nail.protrusion_mm)
    ax.set(
        ylim=(bottom, top),
        xlim=(-0.6, max(first - 1, 4) + 0.6),
        xlabel="strike",
        ylabel="nail over the wood [mm]",
    )
    ax.xaxis.set_major_locator(mpl.ticker.MaxNLocator(integer=True, nbins=9))
    ax.grid(axis="y", color=_GRID, lw=0.8)
    ax.set_axisbelow(True)
    ax.tick_params(colors=_MUTED)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(_GRID)
    place = ax.get_position()  # leave room for the axes' labels
    ax.set_position((place.x0 + 0.03, place.y0 + 0.03, place.width - 0.03, place.height - 0.03))
