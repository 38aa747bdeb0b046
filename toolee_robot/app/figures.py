"""The figures of a job: what --json prints, and what its summary keeps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from toolee_robot.app.sources import Opened
from toolee_robot.control.tool_weight import ToolWeight
from toolee_robot.robots import hand_model
from toolee_robot.runtime.processes import code_version
from toolee_robot.tasks.common.outcome import HammerResult, NailResult, Outcome
from toolee_robot.tools import Tool

if TYPE_CHECKING:
    from toolee_robot.sim_backend.truth import NailTruth, StrikeTruth, Verdict

TRUE_FIGURES = (
    "pose_error_mm", "pose_error_deg", "strike_offset_mm", "strike_tilt_deg", "contact_speed", "off_face_strikes",
)  # fmt: skip
NAIL_FIGURES = ("bend_deg", "lean_deg", "shift_mm")
"""Figures that only a simulation knows: of the job, and of each nail."""


@dataclass(frozen=True, eq=False)
class Ran:
    """A job that has run.

    Attributes:
        result: What the robot knows.
        verdict: What the simulation knows; None for a real station.
        truths: The strikes by the simulation; empty for a real station.
        opened: The devices, which are closed by now.
        seconds: What it took [s].
        longest_stall: The machine's longest stall meanwhile [s]; None where nobody watched.
        machine_stalled: Whether that excuses how it ended.
    """

    result: HammerResult
    verdict: Verdict | None
    truths: tuple[StrikeTruth, ...]
    opened: Opened
    seconds: float
    longest_stall: float | None
    machine_stalled: bool


def job_figures(ran: Ran, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Compute the figures of a job.

    Args:
        ran: The job.
        facts: What identifies it.

    Returns:
        The values that --json prints, by name, but for the folder.
    """
    result, opened, verdict = ran.result, ran.opened, ran.verdict
    truth = None if verdict is None else verdict.worst([nail.name for nail in result.nails])
    success, outcome, reason = _judged(ran, truth)
    measured = None if result.protrusion is None else _rounded(result.protrusion * 1e3)
    hand, strikes = opened.config.hand, result.strikes
    return {
        "success": success,
        "outcome": outcome,
        "reason": reason,
        "stage": None if result.stage is None else str(result.stage),
        "strikes": len(strikes),
        "stops": result.stops,
        "protrusion_mm": measured if truth is None else _rounded(truth.protrusion_mm),
        "measured_protrusion_mm": measured,
        "largest_impulse": _largest(strike.load.impulse for strike in strikes),
        "largest_flange_force": _largest(strike.peak_force for strike in strikes),
        "deepest_mm": _largest(1e3 * strike.deepest for strike in strikes),
        "largest_torque_share": _largest(strike.load.torque_share for strike in strikes),
        "nail": None if truth is None else truth.outcome,
        "nails": [_nail_figures(nail, verdict) for nail in result.nails],
        **{name: None if verdict is None else _rounded(getattr(verdict, name)) for name in TRUE_FIGURES},
        **{f"nail_{name}": None if truth is None else _rounded(getattr(truth, name)) for name in NAIL_FIGURES},
        "stage_seconds": {str(k): round(v, 3) for k, v in result.stage_seconds.items()},
        "robot_seconds": round(result.robot_seconds, 3),
        "nail_seconds": round(result.nail_seconds, 3),
        "seconds": round(ran.seconds, 3),
        **facts,
        "tool": opened.tool,
        "weighed": _weight_figures(result.weight, opened),
        "machine_stall_ms": None if ran.longest_stall is None else _rounded(ran.longest_stall * 1e3),
        "machine_stalled": ran.machine_stalled,
        "robot": str(opened.config.arm.model),
        "hand": hand.model,
        "yield_torque": hand_model(hand).yield_torque,
    }


def job_summary(ran: Ran, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Compute what `summary.json` keeps.

    Args:
        ran: The job.
        figures: Its figures.

    Returns:
        The figures and the logs, for JSON.
    """
    grasp = ran.opened.grasp
    return {
        **figures,
        "version": code_version(),
        "strike_log": [{"nail": nail.name, **asdict(s)} for nail in ran.result.nails for s in nail.strikes],
        "strike_truth": [asdict(truth) for truth in ran.truths],
        "nominal_X_hand_ee": None if grasp.ee_off else grasp.X_hand_ee.tolist(),
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
            for stamp, estimate in ran.result.estimates
        ],
        "station": asdict(ran.opened.config),
    }


def _judged(ran: Ran, truth: NailTruth | None) -> tuple[bool, str, str]:
    """Success, outcome and reason: the robot measures the nail by touch; the simulation knows its true state."""
    result = ran.result
    success, outcome, reason = result.success, str(result.outcome), result.reason
    if success and truth is not None and truth.outcome != "flush":
        from toolee_robot.sim_backend.truth import NOT_BY_FACE

        success = False
        which = f"the nail {truth.name}" if len(result.nails) > 1 else "the nail"
        how = {NOT_BY_FACE: "only strikes beside the face drove it"}.get(truth.outcome, f"it is {truth.outcome}")
        reason = f"the robot reports {which} as flush ({reason}), but {how}"
        if truth.outcome == "bent":
            outcome = str(Outcome.BENT)
    if ran.machine_stalled:
        reason += (
            f". This computer stalled for up to {(ran.longest_stall or 0.0) * 1e3:.0f} ms, probably because a "
            "virtual machine lost its cores. Try again, or use a smaller --real-time-factor"
        )
    return success, outcome, reason


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


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _largest(values: Iterable[float]) -> float | None:
    return _rounded(max(values, default=None))
