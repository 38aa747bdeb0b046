"""Console output of a job: stage by stage while it runs, and at its end what the robot measured and what is true."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.panel import Panel

from toolee_robot.app.sources import JobObserver
from toolee_robot.control.arm_dynamics import StrikeLoad
from toolee_robot.control.records import StrikePlan
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.runtime.pose_text import pose_text, sigma_text
from toolee_robot.tasks.common.outcome import HammerResult, NailResult, Outcome, Stage, Strike
from toolee_robot.types import InHandEstimate, RgbdFrame, ToolEstimate

if TYPE_CHECKING:
    from toolee_robot.viewer.rerun_page import LivePage  # needs the extra `viewer`

# ruff: noqa: ARG002 - an observer receives more than it shows


_STAGES = {
    Stage.HANDOVER: ("Handover", "waiting for the tool in the open hand"),
    Stage.GRIP: ("Grip", "closing the fingers, confirming the hold"),
    Stage.WEIGH: ("Weigh", "weighing the tool, the wrist turns slowly"),
    Stage.VIEW: ("Look", "bringing the tool before the camera"),
    Stage.PERCEIVE: ("Look", "finding the end effector and its pose"),
    Stage.PLAN: ("Drive the nail", "planning the strike"),
    Stage.TOUCH: ("Drive the nail", "measuring the nail with a slow touch"),
    Stage.STRIKE: ("Drive the nail", "striking"),
    Stage.PARK: ("Park", "putting the arm away"),
}
"""Phase of each stage in the output, and what is done in it; stages that alternate are one phase."""


class ConsoleObserver(JobObserver):
    """Writes stages, poses with their uncertainty, and the nail after each strike to a console.

    Args:
        console: The console.
        nails: Number of nails that are to be driven.
        flush: Largest height of a nail's head over the wood that counts as flush [m].
        ask: Asks the person at the terminal; None where nobody is there.
        page: The page in the browser that shows the job, too; None for none.
    """

    def __init__(
        self,
        console: Console,
        nails: int,
        flush: float,
        ask: Callable[[str], str] | None,
        page: LivePage | None,
    ) -> None:
        self._console, self._ask, self._page = console, ask, page
        self._start = self._last = 0.0
        self._nails, self._nail, self._flush = nails, 0, flush
        self._status = console.status("starting")
        self._phase, self._phase_seconds, self._plan_shown = "", 0.0, False

    def live(self) -> AbstractContextManager[object]:
        """Context in which a line says what goes on, if the console is a terminal."""
        return self._status

    def doing(self, text: str) -> None:
        self._console.print(f"[dim]{escape(text)}[/dim]")

    def opened(self, title: str, mode: str, recorder: RunRecorder) -> None:
        self._console.print(f"[bold]{escape(title)}[/bold]  [dim]{escape(mode)}[/dim]")
        if self._page is not None:
            self._page.follow(recorder)

    def prompt(self, text: str) -> None:
        self._console.print(f"  [bold yellow]> {escape(text)}[/bold yellow]")
        if self._page is not None:
            self._page.prompt(text)

    def ask(self, question: str) -> str | None:
        return None if self._ask is None else self._ask(question)

    def stage_started(self, stage: Stage) -> None:
        phase, doing = _STAGES[stage]
        if phase != self._phase:
            self._close_phase()
            self._phase, self._phase_seconds, self._plan_shown = phase, 0.0, False
            self._console.print(f"[bold]{phase}[/bold]")
        self._status.update(doing)

    def stage_ended(self, stage: Stage, seconds: float) -> None:
        self._phase_seconds += seconds

    def _close_phase(self) -> None:
        if self._phase:
            self._console.print(f"  [dim]{self._phase_seconds:.1f} s[/dim]")
        self._phase = ""

    def message(self, text: str) -> None:
        self._console.print(f"  [yellow]{escape(text)}[/yellow]")

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        heads = [e for e in estimates if e.category is Category.HAMMER_HEAD]
        if not heads:
            self._console.print("    frame: no hammer head found")
            return
        best = max(heads, key=lambda e: (e.usable, e.confidence))
        verdict = "" if best.usable else f"  [red]not used: {escape(best.reason)}[/red]"
        sigma = sigma_text(best.covariance, best.X_camera_ee)
        self._console.print(f"    hammer head  {sigma}  confidence {best.confidence:.2f}{verdict}")

    def in_hand(self, stamp: float, estimate: InHandEstimate) -> None:
        colour = "cyan" if estimate.usable else "red"
        name = estimate.category.label
        sigma = sigma_text(estimate.covariance, estimate.X_hand_ee)
        self._console.print(
            f"  [bold {colour}]{name} in the hand[/bold {colour}]  {pose_text(estimate.X_hand_ee)}\n"
            f"    {sigma}  from {estimate.frames_used} of {estimate.frames_seen} frames"
            + ("" if estimate.usable else f"  [red]{escape(estimate.reason)}[/red]")
        )

    def nail_started(self, name: str, protrusion: float) -> None:
        self._start = self._last = protrusion
        self._nail += 1
        if self._nails > 1:
            self._close_phase()
            self._console.print(f"[bold magenta]Nail {escape(name)}[/bold magenta]  ({self._nail} of {self._nails})")

    def nail_ended(self, result: NailResult) -> None:
        if self._nails > 1:
            colour = "green" if result.outcome is Outcome.FLUSH else "red"
            outcome = str(result.outcome).replace("_", " ")
            self._console.print(
                f"  [bold {colour}]nail {escape(result.name)}: {outcome}[/bold {colour}]  {escape(result.reason)}"
            )

    def strike(self, strike: Strike) -> None:
        if strike.protrusion is None:
            load = f"{strike.peak_force:.0f} N, {load_text(strike.load)}"
            self._console.print(f"  strike {strike.number:>2}  [dim]nail not measured {load:>29}[/dim]")
            return
        gained = (self._last - strike.protrusion) * 1e3
        self._last = strike.protrusion
        left = max(strike.protrusion, 0.0) / max(self._start, 1e-9)
        bar = "█" * round(10 * min(left, 1.0))
        self._console.print(  # within 80 columns, but for a controller that reports its ratios; the plan has the speed
            f"  strike {strike.number:>2}  {strike.protrusion * 1e3:5.1f} mm left  [dim]({gained:+.1f})[/dim]  "
            f"[blue]{bar:<10}[/blue]  [dim]{strike.peak_force:.0f} N, {load_text(strike.load)}[/dim]"
        )

    def planned(self, stamp: float, plan: StrikePlan) -> None:
        if not self._plan_shown:
            self._plan_shown = True
            lowered = f" (wanted {plan.wanted_speed:.1f})" if plan.speed < 0.99 * plan.wanted_speed else ""
            self._console.print(
                f"  plan: {plan.speed:.2f} m/s{lowered} at the contact, found in {plan.planning_time * 1e3:.0f} ms\n"
                f"    [dim]the tool turned by {np.rad2deg(plan.theta):.0f}° about the nail, everything else at least "
                f"{plan.clearance.distance * 1e3:.0f} mm away[/dim]"
            )
        if self._last <= self._flush:
            self._console.print("  measured as flush; another strike confirms it")

    def ended(self, result: HammerResult) -> None:
        self._close_phase()
        self._status.stop()


def load_text(load: StrikeLoad) -> str:
    """Format the load of a strike: impulse, torque, and the controller's ratios where it has them."""
    ratios = {"deviation": load.position_deviation_ratio, "collision": load.collision_ratio}
    known = "".join(f", {name} {ratio:.2f}" for name, ratio in ratios.items() if ratio is not None)
    return f"{load.impulse:.1f} N s, {100 * load.torque_share:.0f} % torque{known}"


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
        ("robot's time", f"{f['robot_seconds']:.0f} s, {f['nail_seconds']:.0f} s of it at the nail"),
        ("time", f"{f['seconds']:.1f} s  [dim]({stages})[/dim]"),
        ("files", escape(f["run_folder"])),
    ]
    lines = [f"[bold]{escape(f['reason'])}[/bold]", "", *_lines(rows)]
    if f["nail"] is not None:
        lines += ["", "[dim]true values, known to the simulation only[/dim]", *_lines(_true(f))]
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
    return [("tool's mass", f"{weighed['mass']:.2f} ± {weighed['mass_sigma']:.2f} kg, weighed by the arm")]


def _load(f: Mapping[str, Any]) -> Rows:
    if f["largest_impulse"] is None:
        return []
    return [
        ("load at the flange", f"at most {_figure(f['largest_impulse'], ' N s')}, {f['largest_flange_force']:.0f} N"),
        ("load of a joint", f"at most {100 * f['largest_torque_share']:.0f} % of its largest torque"),
        ("deepest command", f"{f['deepest_mm']:.0f} mm beyond the contact, where a strike turns back"),
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
        ("nail", f"{nail}; {off} strike{'' if off == 1 else 's'} hit with another part of the tool" if off else nail),
        *([] if weighed["true_mass"] is None else [("tool's mass", f"{weighed['true_mass']:.2f} kg")]),
    ]


def _figure(value: float | None, unit: str) -> str:
    return "unknown" if value is None else f"{value:z.1f}{unit}"
