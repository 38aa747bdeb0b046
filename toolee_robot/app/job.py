"""One hammering job: its setup, its run, what a person decides after a stop with the tool in the hand, its records."""

from __future__ import annotations

import time
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from toolee_robot.app.figures import Ran, job_figures, job_summary
from toolee_robot.app.sources import JobObserver, Opened, Source
from toolee_robot.app.variant import Variant
from toolee_robot.end_effectors import Category
from toolee_robot.errors import DeviceError, UserError
from toolee_robot.recording import PICTURE, RECORDING
from toolee_robot.recording.mcap_file import tool_model
from toolee_robot.recording.observer import PictureCollector, RecordingObserver
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.runtime.files import RunFolder, json_line, run_folder, write_atomic
from toolee_robot.runtime.latency_monitor import LatencyMonitor, gc_settled
from toolee_robot.runtime.processes import code_version, interrupts_held
from toolee_robot.tasks.common.handed_task import HandedTask, R
from toolee_robot.tasks.common.look import Perceiver
from toolee_robot.tasks.common.observer import Observers
from toolee_robot.tasks.common.outcome import HammerResult, Outcome
from toolee_robot.tasks.hammering.task import HammeringTask

if TYPE_CHECKING:
    from toolee_robot.perception import ToolPerception
    from toolee_robot.sim_backend.truth import Verdict  # a real station loads no simulation


def job_networks(paper_weights: Path | None = None, device: str = "cpu") -> ToolPerception:
    """Load the networks of a job.

    Args:
        paper_weights: Folder of a training of the paper's estimator, which takes the pose network's place; None: what
            ships.
        device: torch device that runs them.

    Returns:
        The networks. The paper's estimator gets no trust model: none was fitted for it, and it has no confidence.

    Raises:
        AssetError: Weights are missing or unreadable.
        UserError: The weights are for clouds of whole tools; code `user.paper_column`.
    """
    from toolee_robot.perception import ToolPerception  # here: a job without networks begins in half the time

    if paper_weights is None:
        return ToolPerception.load(device=device)
    from toolee_robot.perception.detection.segmenter import Segmenter
    from toolee_robot.perception.pose.tooleenet import PaperEstimator

    return ToolPerception(Segmenter.load(device=device), PaperEstimator.load_for_job(paper_weights, device))


def true_poses(opened: Opened) -> Perceiver:
    """The perception of a job that gets the tool's true pose.

    Args:
        opened: The station.

    Returns:
        The perception.

    Raises:
        UserError: The station is no simulation, which alone knows it.
    """
    if opened.truth is None:
        raise UserError(
            f"--variant {Variant.PERFECT_PERCEPTION} needs the tool's true pose, which only a simulation knows"
        )
    from toolee_robot.sim_backend.truth import PerfectPerception  # a real station loads none

    return PerfectPerception(opened.truth)


QUESTION = "Look at the robot. r: resume the job, t: take the hammer out of the hand, q: quit? "
QUESTION_LAST = "The job cannot go on. t: take the hammer out of the hand, q: quit? "
FIRM = "Does somebody hold the hammer firmly? The hand opens. y: yes, n: no? "
"""The questions."""
ASKED_AFTER = (Outcome.DEVICE_FAULT, Outcome.PERSON_NEAR, Outcome.TOOL_LOST, Outcome.WEIGHT_UNKNOWN)
"""Outcomes that leave the arm where it stopped, or at the handover with a tool whose weight is not known."""


def after_stop(task: HandedTask[R], result: R, observer: JobObserver) -> R:
    """Ask a person what to do about a job that stopped with the tool in the hand, until it is out or the job has ended.

    Args:
        task: The job.
        result: Its result so far.
        observer: Asks the person; where nobody answers, the job has ended.

    Returns:
        The job's last result.
    """
    while task.holds_tool and result.outcome in ASKED_AFTER:
        answer = _answer(observer, f"{result.reason}\n{QUESTION if task.resumable else QUESTION_LAST}")
        if answer == "r" and task.resumable:
            with observer.live():
                result = task.resume(confirmed=True)
        elif answer == "t" and _answer(observer, FIRM) == "y":
            _take_out(task, observer)
        elif answer == "q":
            break
    return result


def _take_out(task: HandedTask[Any], observer: JobObserver) -> None:
    try:
        opened = task.give_back()
    except DeviceError as error:
        observer.message(f"the hand did not open: {error}")
        return
    observer.message("the hand is open" if opened else "nobody confirmed to hold the hammer: the hand stays closed")


def _answer(observer: JobObserver, question: str) -> str:
    try:
        answer = observer.ask(question)
    except EOFError:
        answer = None
    return "q" if answer is None else answer.strip().lower()[:1]


STALLED = 0.8
"""Share of what the driver bears at most that a stall of the machine must have taken to excuse a job."""
WRITTEN = {
    Variant.PERFECT_PERCEPTION: "poses from the simulation's ground truth",
    Variant.NO_CORRECTION: "no correction: the job trusts the expected in-hand pose",
}
"""How a title names variants, if not by their names."""


@dataclass(frozen=True)
class JobSpec:
    """A job to run.

    Attributes:
        source: Opens the devices.
        variant: What it does otherwise than the whole system.
        paper_weights: Folder of a training of the paper's estimator, for `Variant.PAPER` alone.
        nails: Names of the nails to drive; empty for all.
        device: torch device of the networks.

    Raises:
        UserError: There is no such nail, or the paper's weights are missing or not wanted.
    """

    source: Source
    variant: Variant = Variant.FULL
    paper_weights: Path | None = None
    nails: tuple[str, ...] = ()
    device: str = "cpu"

    def __post_init__(self) -> None:
        names = self.source.config.work.names
        if unknown := [name for name in self.nails if name not in names]:
            raise UserError(f"--nail {unknown[0]}: the station's nails are {', '.join(names)} (work.nails)")
        if (self.variant is Variant.PAPER) != (self.paper_weights is not None):
            from toolee_robot.perception.pose.tooleenet.estimator import HOW_TO_TRAIN

            raise UserError(
                "give --variant paper and --paper-weights DIR together. DIR is a training of the paper's "
                f"estimator for a job's views, which the shipped one has not learnt:\n{HOW_TO_TRAIN}"
            )

    @property
    def mode(self) -> str:
        """What is real, and what the job does otherwise, in words."""
        other = "" if self.variant is Variant.FULL else WRITTEN.get(self.variant, self.variant.replace("_", " "))
        return ", ".join(words for words in (self.source.mode, other) if words)

    @property
    def facts(self) -> dict[str, Any]:
        """What its records say of the variant."""
        paper = None
        if self.paper_weights is not None:
            from toolee_robot.perception.weight_files import weights_hash

            paper = weights_hash(self.paper_weights)
        return {
            "correction": self.variant.corrects,
            "perfect_perception": self.variant.perfect,
            "ablation": self.variant.ablation,
            "paper_weights": paper,
        }


@dataclass(frozen=True, eq=False)
class JobResult:
    """What came of a job.

    Attributes:
        result: What the robot knows.
        verdict: What the simulation knows; None for a real station.
        figures: The values that --json prints, by name.
        folder: Folder with summary.json, recording.mcap and picture.png.
    """

    result: HammerResult
    verdict: Verdict | None
    figures: dict[str, Any]
    folder: Path

    @property
    def interrupted(self) -> bool:
        """Whether a person interrupted it."""
        return self.result.outcome is Outcome.INTERRUPTED


def run_job(spec: JobSpec, out: Path, observer: JobObserver | None = None) -> JobResult:
    """Do a job and write its folder, whatever its outcome.

    An interrupt stops the arm and is reported; one that comes after the job has ended changes nothing any more. After a
    stop with the tool in the hand the observer is asked. What was recorded is kept whatever goes wrong.

    Args:
        spec: The job.
        out: Parent of the job's folder.
        observer: Watches it, and answers for the person at the terminal; None for nobody.

    Returns:
        What came of it.

    Raises:
        TooleeError: The job could not begin.
    """
    observer = JobObserver() if observer is None else observer
    with ExitStack() as ending, run_folder(out, spec.source.name) as folder:
        spec.source.check(observer.doing)
        observer.doing("loading the networks and building the station")
        result, verdict, figures = _run(spec, folder, observer, ending)
        path = folder.keep()
    return JobResult(result, verdict, {**figures, "run_folder": str(path)}, path)


def _run(
    spec: JobSpec, folder: RunFolder, observer: JobObserver, ending: ExitStack
) -> tuple[HammerResult, Verdict | None, dict[str, Any]]:
    began, source = time.perf_counter(), spec.source
    networks = None if spec.variant.perfect else job_networks(spec.paper_weights, spec.device)
    collector = PictureCollector(source.config.task.flush_protrusion)
    with (
        gc_settled() as settle,
        nullcontext() if source.real_time_factor is None else LatencyMonitor() as machine,
        source.open(observer.prompt, observer.doing) as opened,
        RunRecorder(folder.path / RECORDING, _metadata(spec, opened), observer.message) as recorder,
    ):
        observer.opened(opened.words, spec.mode, recorder)
        if opened.shape is not None:
            recorder.attach("tool.glb", "model/gltf-binary", tool_model(opened.shape))
        perceiver = true_poses(opened) if networks is None else networks
        keeper = RecordingObserver(recorder, opened.station, opened.config)
        task = HammeringTask(
            opened.station, perceiver if spec.variant.corrects else None, opened.config, opened.grasp,
            observer=Observers(observer, keeper, collector), nails=spec.nails or source.config.work.names,
        )  # fmt: skip
        if machine is not None:
            machine.begin()
        settle()
        folder.measured = True
        result = done(task, observer, ending)
        if result.fault is not None and (why := opened.why_late(result.fault)):
            result = replace(result, reason=f"{result.reason}. {why[0].upper()}{why[1:]}")
        stall = None if machine is None else machine.longest
        verdict = None if opened.truth is None else opened.truth.verdict(result.estimates)
        truths = () if opened.truth is None else opened.truth.strikes
    seconds = time.perf_counter() - began
    ran = Ran(result, verdict, truths, opened, seconds, stall, _stalled(source, opened, result, stall))
    figures = job_figures(ran, {**source.facts, "real_time_factor": source.real_time_factor, **spec.facts})
    write_record(folder.path / "summary.json", (json_line(job_summary(ran, figures)) + "\n").encode(), observer)
    strikes = f"{figures['strikes']} strike{'' if figures['strikes'] == 1 else 's'}"
    outcome = "Flush" if figures["success"] else str(figures["outcome"]).replace("_", " ").capitalize()
    picture = collector.picture(f"{outcome} after {strikes}", f"{opened.words}, {spec.mode}")
    write_record(folder.path / PICTURE, picture, observer)
    return result, verdict, figures


def write_record(path: Path, data: bytes, observer: JobObserver) -> None:
    """Write a record of a job; a full disk is said, and loses nothing else.

    Args:
        path: The file.
        data: What it holds.
        observer: Told of a full disk.
    """
    try:
        write_atomic(path, data)
    except UserError as error:
        observer.message(f"{path.name} is missing: {error}")


def done(task: HandedTask[R], observer: JobObserver, ending: ExitStack) -> R:
    """Do a job; from its end on interrupts are held, until its records are written.

    Args:
        task: The job.
        observer: Watches it, and answers for the person at the terminal.
        ending: Holds the interrupts.

    Returns:
        Its result.
    """
    try:
        with observer.live():
            result = task.run()
        result = after_stop(task, result, observer)
        ending.enter_context(interrupts_held(forget=True))
        return result
    except KeyboardInterrupt:
        ending.enter_context(interrupts_held(forget=True))
        return task.result(Outcome.INTERRUPTED, "interrupted by a person; the arm was stopped")


def _metadata(spec: JobSpec, opened: Opened) -> dict[str, Any]:
    """What identifies the run, for its recording."""
    X_tool_ee = opened.grasp.X_tool_ee
    if opened.grasp.ee_off and opened.shape is not None:  # the shape is drawn where its face was seen
        X_tool_ee = opened.shape.ee(Category.HAMMER_HEAD).X_tool_ee
    return {
        **spec.source.facts,
        "correction": spec.variant.corrects,
        "perfect_perception": spec.variant.perfect,
        "code": code_version(),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "tool": opened.tool,
        "title": f"{opened.words}; {spec.mode}",
        "X_hand_ee": opened.grasp.X_hand_ee,
        "X_tool_ee": X_tool_ee,
    }


def _stalled(source: Source, opened: Opened, result: HammerResult, stall: float | None) -> bool:
    """Whether the machine itself stalled for longer than the driver's bounds allow at this real-time factor."""
    factor = source.real_time_factor
    if factor is None or stall is None or result.outcome is not Outcome.DEVICE_FAULT:
        return False
    bounds = opened.config.supervisor
    return stall * factor > STALLED * min(bounds.data_cycles, bounds.overruns) / opened.station.arm.rate
