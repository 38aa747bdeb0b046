"""Base of every pose estimator: from the points of one end effector to a `PoseResult`.

A subclass implements `infer`: from a batch of canonical clouds to poses.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
import torch

from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose.canonical import (
    MIN_KEPT,
    MIN_POINTS,
    PATCHES,
    POINTS,
    CanonicalCloud,
    canonicalize_one,
    with_rest_one,
)
from toolee_robot.perception.pose.network import DIRECTION_DIM
from toolee_robot.perception.pose.pooling import fix_spin, with_spin_variance
from toolee_robot.perception.pose.processes import Process, Sampler
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.types import HoldingHand, PoseHypotheses

CANDIDATES = 20
"""Candidate poses per cloud, as in the paper; 32 give no better accuracy."""
MAX_INPUT = 2048
"""Larger clouds are first thinned to this many points."""
HAND_SPIN_SIGMA = np.deg2rad(12.0)
"""Standard deviation [rad] of a tool's spin in the hand from nominal: the tilt of a handed-over tool."""


@dataclass(frozen=True)
class PoseResult:
    """The pooled pose of one end effector and how it was obtained.

    Attributes:
        category: Category of the end effector.
        X_camera_ee: Pose in the camera frame, 4x4; the spin is fixed by the hand where that was given.
        covariance: 6x6, position [m] then rotation vector [rad], camera axes.
        confidence: Probability in [0, 1] that the pose is within 10 deg and 2 cm, modulo the symmetry.
        usable: Whether the pose may be acted on.
        reason: "ok", or why it may not.
        hypotheses: The candidate poses before pooling.
        features: Input of the confidence model, see `confidence.FEATURES`; empty for estimators without one.
        ambiguous: (3,) in [0, 1]: predicted ambiguity about each axis of the EE.
    """

    category: Category
    X_camera_ee: Array
    covariance: Array
    confidence: float
    usable: bool
    reason: str
    hypotheses: PoseHypotheses
    features: Array
    ambiguous: Array


class CloudEstimator(ABC):
    """A pose estimator on clouds. Stateless.

    Attributes:
        points: Points that the network takes.
        ordered: The first so many of them are farthest-point samples.
        candidates: Candidate poses sampled per cloud.
        of_tool: Whether it takes the whole tool's cloud instead of the EE's.
        uses_completed: Whether it also takes points of completed depth.
        process: Generative process that the network was trained for.
        sampler: Solves the process from noise to candidate poses.
    """

    points: int = POINTS
    ordered: int = PATCHES
    candidates: int = CANDIDATES
    of_tool: bool = False
    uses_completed: bool = True
    process: Process
    sampler: Sampler

    def radius(self, category: Category) -> float:
        """Radius [m] of the sphere around the part of the tool that a cloud of this category shows."""
        return category.spec.radius

    @torch.inference_mode()
    def estimate(
        self,
        points: Array,
        category: Category,
        rest: Array | None = None,
        hand: HoldingHand | None = None,
        seed: int = 0,
        candidates: int | None = None,
        completed: Array | None = None,
    ) -> PoseResult:
        """Estimate the pose of an end effector from its visible points.

        The same input and seed give the same result.

        Args:
            points: Visible points of the EE, (N, 3) [m], camera frame (OpenCV axes).
            category: Category of the EE.
            rest: Visible points of the rest of the tool, (M, 3) [m], camera frame.
            hand: The hand that holds the tool: gives the direction to the rest of the tool where that is not seen, and
                the spin about a symmetric EE's axis.
            seed: Seed of the sampling.
            candidates: Candidate poses; None: the estimator's default.
            completed: Points of the EE's mask with completed depth, (G, 3) [m], camera frame; see
                `depth_completion.py`.

        Returns:
            The pose with its covariance and confidence.

        Raises:
            PerceptionError: There are fewer than 25 finite points, or they form no compact surface.
        """
        points = _finite(points)
        if len(points) < MIN_POINTS:
            raise PerceptionError(
                f"only {len(points)} points of the {category.label} have depth, {MIN_POINTS} are needed: "
                "move the camera closer, or turn the tool into view",
                code="perception.too_few_points",
            )
        generator = torch.Generator().manual_seed(seed)
        visible = len(points)
        points = _thinned(points, generator)
        more = _thinned(_finite(completed), generator) if self.uses_completed and completed is not None else None
        cloud = canonicalize_one(points, self.radius(category), generator, self.points, self.ordered, more)
        if int(cloud.count[0]) < MIN_KEPT:
            raise PerceptionError(
                f"the mask of the {category.label} covers no compact surface: {len(points)} scattered points"
            )
        kept = round(int(cloud.count[0]) / len(points) * visible)
        if rest is not None:
            rest = _finite(rest)
            cloud = with_rest_one(cloud, _thinned(rest, generator), generator)
        from_hand = not bool(cloud.rest_known[0]) and hand is not None
        goal = None
        if bool(cloud.rest_known[0]) and rest is not None:
            goal = np.median(rest, axis=0)
        elif hand is not None:
            goal = hand.X_camera_hand[:3, 3]
        direction = direction_input(cloud, None if goal is None else goal - cloud.centre[0].double().numpy(), from_hand)
        result = self.infer(cloud, [category], direction, np.array([kept]), generator, candidates or self.candidates)[0]
        if hand is not None:
            result = with_hand(result, hand)
        return result

    @abstractmethod
    def infer(
        self,
        cloud: CanonicalCloud,
        categories: list[Category],
        direction: torch.Tensor,
        visible: Array,
        generator: torch.Generator,
        candidates: int,
    ) -> list[PoseResult]:
        """Encode, sample and pool a batch of canonical clouds, without the symmetry fix.

        Args:
            cloud: The canonical clouds, a batch of B.
            categories: Category of each cloud.
            direction: Direction tokens (B, 5) as `direction_input` makes them.
            visible: Number of visible points of each cloud, (B,).
            generator: Draws the noise; on the CPU.
            candidates: Candidate poses per cloud.

        Returns:
            One result per cloud, in the camera frame.
        """


def _finite(points: Array) -> Array:
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    finite = np.isfinite(points)
    return points if finite.all() else points[finite.all(1)]


def _thinned(points: Array, generator: torch.Generator) -> Array:
    if len(points) > MAX_INPUT:
        points = points[torch.randperm(len(points), generator=generator)[:MAX_INPUT].numpy()]
    return points


def with_hand(result: PoseResult, hand: HoldingHand, spin_sigma: float = HAND_SPIN_SIGMA) -> PoseResult:
    """Fix the spin about a symmetric end effector's axis with the hand that holds the tool; see `spin.py`.

    Args:
        result: The estimate from the cloud.
        hand: Pose of the hand and nominal grasp.
        spin_sigma: Standard deviation [rad] of the tool's spin in the hand from nominal.

    Returns:
        The result with the new rotation and covariance.
    """
    group = result.category.symmetry
    R = result.X_camera_ee[:3, :3]
    axis = R @ np.asarray(group.axis)
    variance = float(axis @ result.covariance[3:, 3:] @ axis)
    R_hand_ee = hand.R_hand_tool @ result.category.spec.R_tool_ee
    R_camera_ee = hand.X_camera_hand[:3, :3] @ R_hand_ee
    R_fixed, fixed_variance = fix_spin(R, R_camera_ee, group, variance, spin_sigma**2)
    covariance = result.covariance
    if group.kind is SymmetryKind.CINF:
        covariance = with_spin_variance(covariance, axis, fixed_variance)
    X = transform(R_fixed, result.X_camera_ee[:3, 3])
    return replace(result, X_camera_ee=X, covariance=covariance)


def direction_input(cloud: CanonicalCloud, direction: Array | None, from_hand: bool = False) -> torch.Tensor:
    """The network's direction token.

    Args:
        cloud: The canonical cloud, a batch of one.
        direction: Direction (3,) to the rest of the tool, camera frame, any length; None: unknown.
        from_hand: Whether it points to the hand instead of the visible rest of the tool.

    Returns:
        Token (1, 5); see `network.DIRECTION_DIM`.
    """
    token = np.zeros((1, DIRECTION_DIM), np.float32)
    length = 0.0 if direction is None else float(np.linalg.norm(direction))
    if direction is not None and 1e-6 < length < np.inf:
        token[0] = [*cloud.R[0].cpu().numpy() @ (direction / length), 1.0, from_hand]
    return torch.from_numpy(token)
