"""The result of one hammering job: the panel on the terminal and the exit code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.panel import Panel

from toolee_robot.tasks.common.outcome import Outcome

EXIT_FAILED, EXIT_INTERRUPTED = 1, 130


@dataclass(frozen=True)
class HammerReport:
    """Result of a job.

    Attributes:
        figures: The values that --json prints, by name.
    """

    figures: Mapping[str, Any]

    @property
    def exit_code(self) -> int:
        """Exit code of the command."""
        if self.figures["outcome"] == Outcome.INTERRUPTED:
            return EXIT_INTERRUPTED
        return 0 if self.figures["success"] else EXIT_FAILED

    def panel(self, folder: Path) -> Panel:
        """Format the summary for the console."""
        f = self.figures
        seconds = ", ".join(f"{name} {s:.1f}" for name, s in f["stage_seconds"].items())
        rows = [
            ("strikes", str(f["strikes"])),
            *self._nail_rows(),
            *self._weight_rows(),
            *self._load_rows(),
            *self._true_rows(),
            ("robot's time", f"{f['robot_seconds']:.0f} s, {f['nail_seconds']:.0f} s of it for the nail"),
            ("time", f"{f['seconds']:.1f} s  [dim]({seconds})[/dim]"),
            ("files", escape(str(folder))),
        ]
        lines = [f"[bold]{escape(f['reason'])}[/bold]", ""]
        lines += [f"{name:<22}{value}" for name, value in rows]
        if f["nail"] is not None:
            lines += ["", "[dim]* measured by the simulation; the task cannot see it[/dim]"]
        flush = "the nail is flush" if len(f["nails"]) < 2 else "the nails are flush"
        stage = f" (stage: {f['stage']})" if f["stage"] else ""
        title = flush if f["success"] else str(f["outcome"]).replace("_", " ") + stage
        colour = "green" if f["success"] else "red"
        return Panel("\n".join(lines), title=f"[bold]{title}[/bold]", border_style=colour, expand=False, padding=(1, 2))

    def _weight_rows(self) -> list[tuple[str, str]]:
        weighed = self.figures["weighed"]
        if weighed is None:
            return []
        words = f"{weighed['mass']:.2f} ± {weighed['mass_sigma']:.2f} kg, by the arm"
        if weighed["true_mass"] is not None:
            words += f" ({weighed['true_mass']:.2f} kg *)"
        return [("tool's mass", words)]

    def _load_rows(self) -> list[tuple[str, str]]:
        f = self.figures
        if f["largest_impulse"] is None:
            return []
        flange = f"{_figure(f['largest_impulse'], ' N s')}, {f['largest_flange_force']:.0f} N"
        return [
            ("most at the flange", flange),
            ("most in a joint", f"{100 * f['largest_torque_share']:.0f} % of its largest torque"),
        ]

    def _nail_rows(self) -> list[tuple[str, str]]:
        f = self.figures
        if len(f["nails"]) < 2:
            return [("nail over the wood", _figure(f["protrusion_mm"], " mm"))]
        return [
            (
                f"nail {nail['name']}",
                f"{str(nail['outcome'] or 'not begun').replace('_', ' ')}, {nail['strikes']} strikes, "
                f"{_figure(nail['protrusion_mm'], ' mm')} over the wood",
            )
            for nail in f["nails"]
        ]

    def _true_rows(self) -> list[tuple[str, str]]:
        f = self.figures
        if f["nail"] is None:
            return []
        return [
            ("pose error *", f"{_figure(f['pose_error_mm'], ' mm')}, {_figure(f['pose_error_deg'], '°')}"),
            ("strike offset, tilt *", f"{_figure(f['strike_offset_mm'], ' mm')}, {_figure(f['strike_tilt_deg'], '°')}"),
            ("nail *", self._nail()),
        ]

    def _nail(self) -> str:
        f = self.figures
        words = f"{f['nail']}, leans by {_figure(f['nail_lean_deg'], '°')}, bent by {_figure(f['nail_bend_deg'], '°')}"
        off = f["off_face_strikes"]
        return f"{words}; {off} strike{'' if off == 1 else 's'} not with the face" if off else words


def _figure(value: float | None, unit: str) -> str:
    return "unknown" if value is None else f"{value:.1f}{unit}"
