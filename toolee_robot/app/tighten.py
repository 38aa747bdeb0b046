"""One tightening job in simulation: its setup, its run, its records."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from toolee_robot.app.job import done, job_networks, write_record
from toolee_robot.app.sources import JobObserver, Tell
from toolee_robot.app.variant import Variant
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, rotation_z, transform
from toolee_robot.recording import PICTURE, RECORDING
from toolee_robot.recording.mcap_file import tool_model
from toolee_robot.recording.observer import PictureCollector, RecordingObserver
from toolee_robot.recording.picture import draw
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.robots import hand_model
from toolee_robot.runtime.files import RunFolder, json_line, run_folder
from toolee_robot.runtime.latency_monitor import gc_settled
from toolee_robot.runtime.processes import code_version
from toolee_robot.sim_backend.cell_errors import NOMINAL, CellErrors, DrawnErrors, draw_errors
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.station import StationConfig, ToolEnvelope, sim_station
from toolee_robot.tasks.common.observer import Observers
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.tasks.tightening.records import NutWork, TightenResult
from toolee_robot.tasks.tightening.task import TighteningTask
from toolee_robot.tools import Tool
from toolee_robot.types import RgbdFrame, ToolEstimate

if TYPE_CHECKING:
    from toolee_robot.sim_backend.bolt import NutVerdict

TORQUES = (2.0, 4.0)
"""Range of the torque that hand and arm bear, and measure [Nm]."""
TOLERANCE = 0.25
"""Largest difference of the true torque from the wanted one, as a share of it, that counts as success."""
FLATS_ERROR = float(np.deg2rad(2.0))
"""Standard deviation of the direction of the nut's flats that a person measures [rad]; assumed."""
VARIANTS = (Variant.FULL, Variant.NO_CORRECTION)


def nut_station() -> StationConfig:
    """The simulated station with a bolt in the place of the nail: its nut is where the nail's head was.

    Returns:
        The station.
    """
    config = sim_station()
    work = replace(
        config.work, nail_xy=(0.64, 0.0), block_size=(0.05, 0.05, 0.06), stand_size=(0.05, 0.05),
        nail_protrusion=0.045, nail_length=0.06,
    )  # fmt: skip
    return replace(config, work=work, tool_envelope=ToolEnvelope(0.02, 0.02, 0.016, 0.016, 0.002, 0.21))


@dataclass(frozen=True)
class TightenSpec:
    """A tightening job in simulation.

    Attributes:
        seed: Seed of wrench, nut, grasp and noise.
        torque: Torque to tighten to [Nm].
        variant: What it does otherwise than the whole system.
        errors: Sizes of the errors of what the job is told.
        device: torch device of the networks.

    Raises:
        UserError: A value is out of its range.
    """

    seed: int
    torque: float = TORQUES[1]
    variant: Variant = Variant.FULL
    errors: CellErrors = NOMINAL
    device: str = "cpu"

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**31:
            raise UserError(f"--seed {self.seed}: give a whole number from 0 to {2**31 - 1}")
        if not TORQUES[0] <= self.torque <= TORQUES[1]:
            raise UserError(f"--torque {self.torque:g}: the hand bears {TORQUES[0]:g} to {TORQUES[1]:g} Nm")
        if self.variant not in VARIANTS:
            raise UserError(f"--variant {self.variant}: a tightening job has {', '.join(VARIANTS)}")


@dataclass(frozen=True, eq=False)
class TightenJob:
    """What came of a tightening job.

    Attributes:
        result: What the robot knows.
        figures: The values that --json prints, by name.
        folder: Folder with summary.json, recording.mcap and picture.png.
    """

    result: TightenResult
    figures: dict[str, Any]
    folder: Path


class _Told(JobObserver):
    """Tells what happens, line by line."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell

    def message(self, text: str) -> None:
        self._tell(text)


def run_tighten(spec: TightenSpec, out: Path, tell: Tell = lambda _: None) -> TightenJob:
    """Do a tightening job and write its folder, whatever its outcome; see `app.job.run_job`.

    Args:
        spec: The job.
        out: Parent of the job's folder.
        tell: Told what happens, line by line.

    Returns:
        What came of it.

    Raises:
        TooleeError: The job could not begin.
    """
    observer = _Told(tell)
    with ExitStack() as ending, run_folder(out, f"seed{spec.seed}") as folder:
        tell("loading the networks and building the station")
        result, figures = _run(spec, folder, observer, ending)
        path = folder.keep()
    return TightenJob(result, {**figures, "run_folder": str(path)}, path)


def _run(
    spec: TightenSpec, folder: RunFolder, observer: JobObserver, ending: ExitStack
) -> tuple[TightenResult, dict[str, Any]]:
    from toolee_robot.sim_backend.bolt import Bolt, X_base_bolt, bolt_station

    began = time.perf_counter()
    networks = job_networks(device=spec.device) if spec.variant.corrects else None
    cell, drawn = nut_station(), draw_errors(spec.errors, spec.seed)
    config = drawn.weighed(drawn.displaced(cell))
    bolt = Bolt.draw(spec.seed)
    collector, mode = _Picture(config.task.flush_protrusion), f"seed {spec.seed}, {spec.variant.replace('_', ' ')}"
    with (
        gc_settled() as settle,
        bolt_station(cell, spec.seed, drawn.options(SimOptions()), bolt) as sim,
    ):
        tool = sim.world.tool.tool
        grasp = _measured(tool, config, drawn)
        off = FLATS_ERROR * np.random.default_rng([spec.seed, 41]).standard_normal()
        X_base_nut = X_base_bolt(config.work) @ transform(rotation_z(bolt.flats + off))
        facts = {"source": "simulation", "seed": spec.seed, "arm": "sim", "errors": drawn.facts}
        facts |= {"correction": spec.variant.corrects}
        words = f"Open-ended wrench, {1e3 * bolt.jaw.opening:.0f} mm, {tool.mass:.2f} kg, never used in training"
        with RunRecorder(folder.path / RECORDING, _metadata(facts, grasp, tool, words), observer.message) as recorder:
            observer.message(f"{words}: {mode}")
            recorder.attach("tool.glb", "model/gltf-binary", tool_model(tool))
            keeper = RecordingObserver(recorder, sim.station, config)

            task = TighteningTask(
                sim.station, networks, config, grasp, NutWork(X_base_nut, torque=spec.torque),
                observer=Observers(observer, keeper, collector),
            )  # fmt: skip
            settle()
            folder.measured = True
            result = done(task, observer, ending)
            for turn in result.turns:
                recorder.record_decision(turn.stamp, "turn", str(turn), asdict(turn))
            said = f"{str(result.outcome).replace('_', ' ')}: {result.reason}"
            recorder.record_decision(sim.station.clock.now(), "ended", said, {"outcome": str(result.outcome)})
        verdict = sim.judge.verdict(result.estimates)
    figures = {
        **_figures(spec, result, verdict), "seconds": round(time.perf_counter() - began, 3), **facts,
        "tool": tool.name, "robot": str(config.arm.model), "hand": config.hand.model,
    }  # fmt: skip
    summary = {**figures, "version": code_version(), "turns": [asdict(turn) for turn in result.turns]}
    summary |= {"station": asdict(config), "nut": asdict(bolt)}
    write_record(folder.path / "summary.json", (json_line(summary) + "\n").encode(), observer)
    title = f"{str(result.outcome).replace('_', ' ').capitalize()}, {verdict.torque:.1f} Nm"
    write_record(folder.path / PICTURE, collector.picture(title, f"{words}, {mode}"), observer)
    return result, figures


def _measured(tool: Tool, config: StationConfig, drawn: DrawnErrors) -> Grasp:
    """Nominal grasp of a wrench that a person has measured with ruler and scales."""
    z, sizes = drawn.tool, drawn.sizes
    X_tool_ee: Array = transform(p=sizes.ruler * z[1:4]) @ tool.ee(Category.WRENCH_HEAD).X_tool_ee
    radius = max(5e-3, tool.handle.grip_radius + 0.5 * sizes.ruler * float(z[0]))
    X_hand_tool = hand_model(config.hand).grasp.X_hand_tool(radius)
    return Grasp(X_hand_tool, X_tool_ee, tool.mass * (1.0 + sizes.scales * float(z[7])), tool.center_of_mass)


def _metadata(facts: dict[str, Any], grasp: Grasp, tool: Tool, words: str) -> dict[str, Any]:
    return {
        **facts,
        "code": code_version(),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "tool": tool.name,
        "title": words,
        "X_hand_ee": grasp.X_hand_ee,
        "X_tool_ee": grasp.X_tool_ee,
    }


def _figures(spec: TightenSpec, result: TightenResult, verdict: NutVerdict) -> dict[str, Any]:
    """What --json prints of a job: the robot measures the torque, the simulation knows it."""
    near = abs(verdict.torque - spec.torque) <= TOLERANCE * spec.torque
    reason = result.reason
    if result.success and not near:
        reason = f"the robot reports the nut as tight ({reason}), but the torque is {verdict.torque:.1f} Nm"
    error = verdict.error
    return {
        "success": result.success and near,
        "outcome": str(result.outcome),
        "reason": reason,
        "stage": None if result.stage is None else str(result.stage),
        "strokes": len(result.turns),
        "stops": result.stops,
        "wanted_torque": spec.torque,
        "torque": round(verdict.torque, 3),
        "measured_torque": None if result.torque is None else round(result.torque, 3),
        "turned_deg": round(float(np.rad2deg(verdict.turned)), 1),
        "slips": verdict.slips,
        "pose_error_mm": None if error is None else round(error.position_mm, 3),
        "pose_error_deg": None if error is None else round(error.angle_deg, 3),
        "stage_seconds": {str(k): round(v, 3) for k, v in result.stage_seconds.items()},
        "robot_seconds": round(result.robot_seconds, 3),
    }


class _Picture(PictureCollector):
    """Collects the frame of the first look in which the jaw is seen best."""

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:  # noqa: ARG002
        jaws = [(e.usable, e.confidence) for e in estimates if e.category is Category.WRENCH_HEAD]
        rank = max(jaws, default=self._rank)
        if self._best is None or rank > self._rank:
            self._best, self._rank = (frame, estimates), rank

    def picture(self, title: str, note: str) -> bytes:
        frame, estimates = self._best or (None, [])
        return draw(frame, estimates, title=title, note=note, focus=Category.WRENCH_HEAD)
