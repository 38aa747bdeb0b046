"""What a job perceives with: the networks, the simulation's ground truth, or what is compared with them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from toolee_robot.cli.hammering.sources import Opened
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.perception import ToolPerception
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.sim_backend.ground_truth.perception import PerfectPerception
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.look import Perceiver
from toolee_robot.tasks.hammering.ablation import Ablation, ablated
from toolee_robot.tasks.hammering.learnt_grasp import LearntShift

SURFACE = 20_000
"""Number of points on the tool's surface that a registration uses."""


BELIEVES_NOMINAL = (Ablation.POSITION_ONLY, Ablation.NORMAL_ONLY, Ablation.MASK_CENTROID, Ablation.LEARNT_GRASP)
"""What takes the face's nominal place or direction for the true one, or begins with it."""


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
    if paper_weights is None:
        return ToolPerception.load(device=device)
    from toolee_robot.perception.offline.research.tooleenet import PaperEstimator

    return ToolPerception(Segmenter.load(device=device), PaperEstimator.load_for_job(paper_weights, device))


def job_perceiver(
    ablation: Ablation | None,
    perception: ToolPerception | None,
    opened: Opened,
    shift: LearntShift | None = None,
) -> tuple[Perceiver, StationConfig]:
    """Build the perception of a job.

    Args:
        ablation: What it leaves out or does instead; None for nothing.
        perception: The networks; None for the simulation's ground truth.
        opened: The station.
        shift: How the hand moves tools as it closes, for `Ablation.LEARNT_GRASP`.

    Returns:
        The perception, and the configuration of the job.

    Raises:
        UserError: `ICP` without the tool's shape, which only a simulation has; code `user.no_tool_shape`. What believes
            a part of the face's nominal pose, of a tool whose face nobody has measured; code `user.unknown_face`.
    """
    if opened.grasp.ee_off and ablation in BELIEVES_NOMINAL:
        raise UserError(
            f"--ablation {ablation} believes a part of the face's nominal pose, and the tool's face is not known: give "
            "tool.face and tool.face_normal, or leave the option out",
            code="user.unknown_face",
        )
    if perception is None:
        assert opened.truth is not None, "the command refuses it"
        return PerfectPerception(opened.truth), opened.config
    pose_of = None
    if ablation in (Ablation.MASK_CENTROID, Ablation.ICP):
        from toolee_robot.perception.offline.research import classical
    if ablation is Ablation.MASK_CENTROID:
        pose_of = partial(classical.pose_of, classical.centroid_pose)
    elif ablation is Ablation.ICP:
        pose_of = partial(classical.pose_of, classical.registration(_surface(opened)))
    return ablated(ablation, perception, opened.config, opened.grasp.X_hand_ee, pose_of, shift)


def _surface(opened: Opened) -> Array:
    """Points on the tool's surface in the frame of its striking face, (S, 3) [m]."""
    if opened.shape is None:
        raise UserError(
            "--ablation icp needs the tool's shape, which only a simulation knows: leave it out",
            code="user.no_tool_shape",
        )
    points = opened.shape.mesh.sample(SURFACE, seed=0)
    return transform_points(inverse(opened.shape.ee(Category.HAMMER_HEAD).X_tool_ee), points)
