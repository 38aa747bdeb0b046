"""What a job perceives with: the networks, or the simulation's ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from toolee_robot.app.sources import Opened
from toolee_robot.app.variant import Variant
from toolee_robot.errors import UserError
from toolee_robot.tasks.common.look import Perceiver

if TYPE_CHECKING:
    from toolee_robot.perception import ToolPerception


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
