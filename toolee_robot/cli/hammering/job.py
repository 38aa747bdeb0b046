"""One hammering job on a simulated station: setup, run, evaluation and records."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.hammering.console import ConsoleObserver
from toolee_robot.cli.hammering.perceivers import job_networks, job_perceiver
from toolee_robot.cli.hammering.report import HammerReport
from toolee_robot.cli.hammering.sources import Opened, Source
from toolee_robot.cli.hammering.stops import after_stop
from toolee_robot.cli.output import json_line
from toolee_robot.control.dynamics.tool_weight import ToolWeight
from toolee_robot.end_effectors import Category
from toolee_robot.perception.weight_files import weights_hash
from toolee_robot.recording import PICTURE, RECORDING
from toolee_robot.recording.observer import PictureCollector, RecordingObserver
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.recording.tool_file import tool_model
from toolee_robot.robots import hand_model
from toolee_robot.runtime.code_version import code_version
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.gc_pause import gc_settled
from toolee_robot.runtime.latency_monitor import LatencyMonitor
from toolee_robot.sim_backend.ground_truth.verdict import NOT_BY_FACE, NailTruth, StrikeTruth, Verdict
from toolee_robot.tasks.common.observer import Observers
from toolee_robot.tasks.common.outcome import HammerResult, NailResult, Outcome
from toolee_robot.tasks.hammering.ablation import Ablation
from toolee_robot.tasks.hammering.learnt_grasp import learn_shift
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.tools import Tool

if TYPE_CHECKING:
    from toolee_robot.viewer.live_page import LivePage  # needs the extra `viewer`

PAGE_PORT = 8080
"""Port of the page of a running job; the next free one where it is in use."""
TRUE_FIGURES = (
    "pose_error_mm", "pose_error_deg", "strike_offset_mm", "strike_tilt_deg", "contact_speed", "off_face_strikes",
)  # fmt: skip
NAIL_FIGURES = ("bend_deg", "lean_deg", "shift_mm")
"""Figures that only a simulation knows: of the job, and of each nail."""


STALLED = 0.8
"""Share of what the driver bears at most that a stall of the machine must have taken to excuse a job."""


@dataclass(frozen=True)
class HammerJob:
    """A job to run.

    Attributes:
        source: Opens the devices.
        correction: Whether the estimated in-hand pose is used.
        perfect_perception: Whether poses come from the ground truth, for tests and ablations only.
        ablation: What perception leaves out; None for nothing.
        paper_weights: Folder of a training of the paper's estimator, for `Ablation.PAPER`.
        learnt_from: Folder with the runs of earlier jobs, for `Ablation.LEARNT_GRASP`.
        ask: Asks the person at the terminal what to do after a stop; None: the job then ends.
        view: Whether a page in the browser shows the job, too.
        nails: Names of the nails to drive; empty for all.
        device: torch device of the networks.
    """

    source: Source
    correction: bool = True
    perfect_perception: bool = False
    ablation: Ablation | None = None
    paper_weights: Path | None = None
    learnt_from: Path | None = None
    ask: Callable[[str], str] | None = None
    view: bool = False
    nails: tuple[str, ...] = ()
    device: str = "cpu"

    def run(self, folder: Path, console: Console) -> HammerReport:
        """Do the job and write summary.json, recording.mcap and picture.png, whatever its outcome.

        An interrupt stops the arm and is reported.

        Args:
            folder: Folder for the files.
            console: The console.

        Returns:
            The report.

        Raises:
            TooleeError: The job could not begin.
        """
        began = time.perf_counter()
        perception = None if self.perfect_perception else job_networks(self.paper_weights, self.device)
        hand = str(self.source.config.hand.model)
        shift = None if self.learnt_from is None else learn_shift(self.learnt_from, hand)
        names, flush = self.nails or self.source.config.work.names, self.source.config.task.flush_protrusion
        screen, collector = ConsoleObserver(console, flush, len(names)), PictureCollector(flush)
        with (
            gc_settled() as settle,
            nullcontext() if self.source.real_time_factor is None else LatencyMonitor() as machine,
            self._page(console) as page,
            self.source.open(
                lambda text: _prompt(text, screen, page), lambda text: console.print(f"[dim]{escape(text)}[/dim]")
            ) as opened,
            RunRecorder(folder / RECORDING, self._metadata(opened), _warner(console)) as recorder,
        ):
            console.print(f"[bold]{escape(opened.words)}[/bold]  [dim]{escape(self._mode())}[/dim]")
            station = opened.station
            if page is not None:
                page.follow(recorder)
            if opened.shape is not None:
                recorder.attach("tool.glb", "model/gltf-binary", tool_model(opened.shape))
            keeper = RecordingObserver(recorder, station, opened.config)
            perceiver, config = job_perceiver(self.ablation, perception, opened, shift)
            task = HammeringTask(
                station, perceiver, config, opened.grasp,
                correction=self.correction,
                observer=Observers(screen, keeper, collector), nails=names,
            )  # fmt: skip
            if machine is not None:
                machine.begin()
            settle()
            try:
                with screen.live():
                    result = task.run()
                if self.ask is not None:
                    result = after_stop(task, result, self.ask, console, lambda: _resume(task, screen))
            except KeyboardInterrupt:
                reason = "interrupted by a person; the arm was stopped"
                result = task.result(Outcome.INTERRUPTED, reason)
            if result.fault is not None and (why := opened.why_late(result.fault)):
                result = replace(result, reason=f"{result.reason}. {why[0].upper()}{why[1:]}")
            longest_stall = None if machine is None else machine.longest
            verdict = None if opened.truth is None else opened.truth.verdict(result.estimates)
            truths = () if opened.truth is None else opened.truth.strikes
        figures = self._figures(result, verdict, opened, time.perf_counter() - began, longest_stall)
        figures["learnt_grasp"] = None if shift is None else shift.figures
        self._write(folder, figures, result, truths, collector, opened)
        return HammerReport(figures)

    @contextmanager
    def _page(self, console: Console) -> Iterator[LivePage | None]:
        if not self.view:
            yield None
            return
        from toolee_robot.viewer.live_page import LivePage

        page = LivePage(self.source.config, PAGE_PORT)
        console.print(f"[dim]The job is shown at[/dim] [bold]{page.address}[/bold]")
        try:
            yield page
        finally:
            page.close()

    def _metadata(self, opened: Opened) -> dict[str, Any]:
        """What identifies the run, for its recording."""
        X_tool_ee = opened.grasp.X_tool_ee
        if opened.grasp.ee_off and opened.shape is not None:  # the shape is drawn where its face was seen
            X_tool_ee = opened.shape.ee(Category.HAMMER_HEAD).X_tool_ee
        return {
            **self.source.facts,
            "correction": self.correction,
            "perfect_perception": self.perfect_perception,
            "code": code_version(),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "tool": opened.tool,
            "title": f"{opened.words}; {self._mode()}",
            "X_hand_ee": opened.grasp.X_hand_ee,
            "X_tool_ee": X_tool_ee,
        }

    def _mode(self) -> str:
        words = [self.source.mode]
        if self.perfect_perception:
            words.append("poses from the simulation's ground truth")
        elif not self.correction:
            words.append("no correction: the nominal in-hand pose is believed")
        if self.ablation is not None:
            words.append(self.ablation.replace("_", " "))
        return ", ".join(word for word in words if word)

    def _machine_stalled(self, result: HammerResult, opened: Opened, longest_stall: float | None) -> bool:
        """Whether the machine itself stalled for longer than the driver's bounds allow at this real-time factor."""
        factor = self.source.real_time_factor
        if factor is None or longest_stall is None or result.outcome is not Outcome.DEVICE_FAULT:
            return False
        bounds = opened.config.supervisor
        return longest_stall * factor > STALLED * min(bounds.data_cycles, bounds.overruns) / opened.station.arm.rate

    def _figures(
        self,
        result: HammerResult,
        verdict: Verdict | None,
        opened: Opened,
        seconds: float,
        longest_stall: float | None,
    ) -> dict[str, Any]:
        success, outcome, reason = result.success, str(result.outcome), result.reason
        truth = None if verdict is None else verdict.worst([nail.name for nail in result.nails])
        if success and truth is not None and truth.outcome != "flush":
            # The robot measures the nail by touch; the simulation knows its true state.
            success = False
            which = f"the nail {truth.name}" if len(result.nails) > 1 else "the nail"
            how = {NOT_BY_FACE: "strikes without the face drove it"}.get(truth.outcome, f"it is {truth.outcome}")
            reason = f"the robot takes {which} for flush ({reason}), but {how}"
            if truth.outcome == "bent":
                outcome = str(Outcome.BENT)
        machine_stalled = self._machine_stalled(result, opened, longest_stall)
        if machine_stalled:
            reason += (
                f". This machine itself stalled meanwhile, for up to {(longest_stall or 0.0) * 1e3:.0f} ms: the "
                "host "
                "of a virtual machine takes its cores away. Try again, or with a smaller --real-time-factor, which "
                "tolerates more"
            )
        measured = None if result.protrusion is None else _rounded(result.protrusion * 1e3)
        hand = opened.config.hand
        return {
            "success": success,
            "outcome": outcome,
            "reason": reason,
            "stage": None if result.stage is None else str(result.stage),
            "strikes": len(result.strikes),
            "stops": result.stops,
            "protrusion_mm": measured if truth is None else _rounded(truth.protrusion_mm),
            "measured_protrusion_mm": measured,
            "largest_impulse": _largest([strike.load.impulse for strike in result.strikes]),
            "largest_flange_force": _largest([strike.peak_force for strike in result.strikes]),
            "largest_torque_share": _largest([strike.load.torque_share for strike in result.strikes]),
            "nail": None if truth is None else truth.outcome,
            "nails": [_nail_figures(nail, verdict) for nail in result.nails],
            **{name: None if verdict is None else _rounded(getattr(verdict, name)) for name in TRUE_FIGURES},
            **_true_nail_figures(truth),
            "stage_seconds": {str(k): round(v, 3) for k, v in result.stage_seconds.items()},
            "robot_seconds": round(result.robot_seconds, 3),
            "nail_seconds": round(result.nail_seconds, 3),
            "seconds": round(seconds, 3),
            **self.source.facts,
            "tool": opened.tool,
            "weighed": _weight_figures(result.weight, opened),
            "real_time_factor": self.source.real_time_factor,
            "machine_stall_ms": None if longest_stall is None else _rounded(longest_stall * 1e3),
            "machine_stalled": machine_stalled,
            "robot": str(opened.config.arm.model),
            "hand": hand.model,
            "yield_torque": hand_model(hand).yield_torque,
            "correction": self.correction,
            "perfect_perception": self.perfect_perception,
            "ablation": self.ablation,
            "paper_weights": None if self.paper_weights is None else weights_hash(self.paper_weights),
        }

    def _write(
        self,
        folder: Path,
        figures: dict[str, Any],
        result: HammerResult,
        truths: tuple[StrikeTruth, ...],
        collector: PictureCollector,
        opened: Opened,
    ) -> None:
        summary = {
            **figures,
            "version": code_version(),
            "strike_log": [{"nail": nail.name, **asdict(s)} for nail in result.nails for s in nail.strikes],
            "strike_truth": [asdict(truth) for truth in truths],
            "nominal_X_hand_ee": None if opened.grasp.ee_off else opened.grasp.X_hand_ee.tolist(),
            "looks": [
                {
                    "stamp": stamp,
                    "X_hand_ee": estimate.X_hand_ee.tolist(),
                    "covariance": estimate.covariance.tolist(),
                    "confidence": estimate.confidence,
                    "frames_used": estimate.frames_used,
                    "frames_seen": estimate.frames_seen,
                    "camera_error": None if estimate.camera is None else estimate.camera.mean.tolist(),
                }
                for stamp, estimate in result.estimates
            ],
            "station": asdict(opened.config),
        }
        write_atomic(folder / "summary.json", (json_line(summary) + "\n").encode())
        strikes = f"{figures['strikes']} strike{'' if figures['strikes'] == 1 else 's'}"
        outcome = "Flush" if figures["success"] else str(figures["outcome"]).replace("_", " ").capitalize()
        title = f"{outcome} after {strikes}"
        picture = collector.picture(title, f"{opened.words}, {self._mode()}")
        if picture is not None:
            write_atomic(folder / PICTURE, picture)


def _true_nail_figures(truth: NailTruth | None) -> dict[str, float | None]:
    return {f"nail_{name}": None if truth is None else _rounded(getattr(truth, name)) for name in NAIL_FIGURES}


def _weight_figures(weight: ToolWeight | None, opened: Opened) -> dict[str, Any] | None:
    """What the arm has weighed of the tool, flange frame; None where it was told."""
    if weight is None:
        return None
    return {
        "mass": _rounded(weight.mass),
        "mass_sigma": _rounded(weight.mass_sigma),
        "center_of_mass": [round(float(x), 4) for x in weight.center_of_mass],
        "center_sigma": _rounded(weight.center_sigma),
        "true_mass": _rounded(opened.shape.mass) if isinstance(opened.shape, Tool) else None,
    }


def _nail_figures(nail: NailResult, verdict: Verdict | None) -> dict[str, Any]:
    measured = None if nail.protrusion is None else _rounded(nail.protrusion * 1e3)
    truth = None if verdict is None else verdict.worst([nail.name])
    return {
        "name": nail.name,
        "outcome": None if nail.outcome is None else str(nail.outcome),
        "reason": nail.reason,
        "strikes": len(nail.strikes),
        "protrusion_mm": measured if truth is None else _rounded(truth.protrusion_mm),
        "measured_protrusion_mm": measured,
        "nail": None if truth is None else truth.outcome,
        "nail_seconds": round(nail.seconds, 3),
    }


def _warner(console: Console) -> Callable[[str], None]:
    return lambda text: console.print(f"[yellow]{escape(text)}[/yellow]", soft_wrap=True)


def _prompt(text: str, screen: ConsoleObserver, page: LivePage | None) -> None:
    screen.prompt(text)
    if page is not None:
        page.prompt(text)


def _resume(task: HammeringTask, screen: ConsoleObserver) -> HammerResult:
    with screen.live():
        return task.resume(confirmed=True)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _largest(values: list[float]) -> float | None:
    return _rounded(max(values, default=None))
