"""The panel on the terminal at a job's end: what the robot measured, apart from what only the simulation knows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.markup import escape
from rich.panel import Panel

Rows = list[tuple[str, str]]


def job_panel(f: Mapping[str, Any]) -> Panel:
    """Format what came of a job.

    Args:
        f: Its figures.

    Returns:
        The panel.
    """
    stages = ", ".join(f"{name} {s:.1f}" for name, s in f["stage_seconds"].items())
    rows = [("strikes", str(f["strikes"])), *_nails(f, "measured_protrusion_mm"), *_weight(f), *_load(f)]
    rows += [
        ("robot's time", f"{f['robot_seconds']:.0f} s, {f['nail_seconds']:.0f} s of it for the nail"),
        ("time", f"{f['seconds']:.1f} s  [dim]({stages})[/dim]"),
        ("files", escape(f["run_folder"])),
    ]
    lines = [f"[bold]{escape(f['reason'])}[/bold]", "", *_lines(rows)]
    if f["nail"] is not None:
        lines += ["", "[dim]true values, known to the simulation alone[/dim]", *_lines(_true(f))]
    flush = "the nail is flush" if len(f["nails"]) < 2 else "the nails are flush"
    stage = f" (stage: {f['stage']})" if f["stage"] else ""
    title = flush if f["success"] else str(f["outcome"]).replace("_", " ") + stage
    colour = "green" if f["success"] else "red"
    return Panel("\n".join(lines), title=f"[bold]{title}[/bold]", border_style=colour, expand=False, padding=(1, 2))


def _lines(rows: Rows) -> list[str]:
    return [f"{name:<22}{value}" for name, value in rows]


def _weight(f: Mapping[str, Any]) -> Rows:
    weighed = f["weighed"]
    if weighed is None:
        return []
    return [("tool's mass", f"{weighed['mass']:.2f} ± {weighed['mass_sigma']:.2f} kg, by the arm")]


def _load(f: Mapping[str, Any]) -> Rows:
    if f["largest_impulse"] is None:
        return []
    return [
        ("most at the flange", f"{_figure(f['largest_impulse'], ' N s')}, {f['largest_flange_force']:.0f} N"),
        ("most in a joint", f"{100 * f['largest_torque_share']:.0f} % of its largest torque"),
    ]


def _nails(f: Mapping[str, Any], height: str) -> Rows:
    if len(f["nails"]) < 2:
        return [("nail over the wood", _figure(f[height], " mm"))]
    return [
        (
            f"nail {nail['name']}",
            f"{str(nail['outcome'] or 'not begun').replace('_', ' ')}, {nail['strikes']} strikes, "
            f"{_figure(nail[height], ' mm')} over the wood",
        )
        for nail in f["nails"]
    ]


def _true(f: Mapping[str, Any]) -> Rows:
    weighed = f["weighed"] or {"true_mass": None}
    off = f["off_face_strikes"]
    nail = f"{f['nail']}, leans by {_figure(f['nail_lean_deg'], '°')}, bent by {_figure(f['nail_bend_deg'], '°')}"
    return [
        ("pose error", f"{_figure(f['pose_error_mm'], ' mm')}, {_figure(f['pose_error_deg'], '°')}"),
        ("strike offset, tilt", f"{_figure(f['strike_offset_mm'], ' mm')}, {_figure(f['strike_tilt_deg'], '°')}"),
        *_nails(f, "protrusion_mm"),
        ("nail", f"{nail}; {off} strike{'' if off == 1 else 's'} not with the face" if off else nail),
        *([] if weighed["true_mass"] is None else [("tool's mass", f"{weighed['true_mass']:.2f} kg")]),
    ]


def _figure(value: float | None, unit: str) -> str:
    return "unknown" if value is None else f"{value:.1f}{unit}"
