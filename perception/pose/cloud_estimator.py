"""What every pose estimator shares: the points of one EE in, a `PoseResult` out.

A subclass says how a batch of canonical clouds becomes poses (`infer`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
import torch

from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose.canonical import MIN_KEPT, MIN_POINTS, PATCHES, POINTS, CanonicalCloud
from toolee_robot.perception.pose.canonical_single import canonicalize_one, with_rest_one
from toolee_robot.perception.pose.network import DIRECTION_DIM
from toolee_robot.perception.pose.processes.flow import Process, Sampler
from toolee_robot.perception.pose.spin import fix_spin, with_spin_variance
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.types import HoldingHand, PoseHypotheses

CANDIDATES = 20
"""As the paper draws; 32 measured no better."""
MAX_INPUT = 2048
"""More points than this are thinned before anything else."""
HAND_SPIN_SIGMA = np.deg2rad(12.0)
"""How far a tool's spin in the hand strays from nominal: the tilt of a handed-over tool."""


@dataclass(frozen=True)
class PoseResult:
    """The pooled pose of one EE and where it comes from.

    X_camera_ee: 4x4, the spin fixed by the hand where the hand's pose was given. covariance: 6x6, position [m] then
    rotation vector [rad], camera axes. confidence in [0, 1]: probability of being within 10 deg and 2 cm (modulo the
    symmetry). usable, reason: whether to act on it, and why not. modes: masses of the candidates' modes.
    features: the confidence model's input, see `confidence.FEATURES` (empty without one). ambiguous: (3,) in [0, 1],
    about which of the EE's axes the network says that the view leaves the pose open.
    """

    category: Category
    X_camera_ee: Array
    covariance: Array
    confidence: float
    usable: bool
    reason: str
    hypotheses: PoseHypotheses
    modes: tuple[float, ...]
    features: Array
    ambiguous: Array


class CloudEstimator(ABC):
    """From a cloud to a pose. Calls keep no state.

    points, ordered: how many points the network takes, and how many of them are farthest-point samples, first.
    candidates: samples drawn for a pose, by `sampler` from `process`. of_tool: it wants the whole tool's cloud.
    uses_completed: it takes points of a completed depth, too.
    """

    points: int = POINTS
    ordered: int = PATCHES
    candidates: int = CANDIDATES
    of_tool: bool = False
    uses_completed: bool = True
    process: Process
    sampler: Sampler

    def radius(self, category: Category) -> float:
        """Radius [m] of the sphere that holds what the cloud shows."""
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
        """The pose of the EE whose visible points (N, 3) [m] are given in the camera's frame (OpenCV axes).

        rest: (M, 3) [m], the visible points of the rest of the tool, camera frame. completed: (G, 3) [m], likewise,
        those of the EE's mask whose depth is completed from their neighbours' (`depth_completion.py`). hand: the one
        that holds the tool; tells where the rest is if that is not seen, and the spin about a symmetric EE's axis.
        The same input and seed give the same result. Raises PerceptionError with fewer than 25 finite points.
        """
        points = _finite(points)
        if len(points) < MIN_POINTS:
            raise PerceptionError(
                f"only {len(points)} points of the {category} have depth, {MIN_POINTS} are needed: "
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
                f"the mask of the {category} covers no compact surface: {len(points)} scattered points",
                code="perception.scattered_points",
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
        """Encode, sample and pool a batch of canonical clouds; direction (B, 5) as `direction_input` makes it.

        visible: (B,) how many points were seen. The generator lives on the CPU. No spin fix."""


def _finite(points: Array) -> Array:
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    finite = np.isfinite(points)
    return points if finite.all() else points[finite.all(1)]


def _thinned(points: Array, generator: torch.Generator) -> Array:
    if len(points) > MAX_INPUT:
        points = points[torch.randperm(len(points), generator=generator)[:MAX_INPUT].numpy()]
    return points


def with_hand(result: PoseResult, hand: HoldingHand, spin_sigma: float = HAND_SPIN_SIGMA) -> PoseResult:
    """The result with the spin about a symmetric EE's axis fixed by the hand that holds the tool; see `spin.py`."""
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
    """The network's direction token (1, 5) from a direction (3,) in the camera's frame, or None."""
    token = np.zeros((1, DIRECTION_DIM), np.float32)
    length = 0.0 if direction is None else float(np.linalg.norm(direction))
    if direction is not None and 1e-6 < length < np.inf:
        token[0] = [*cloud.R[0].cpu().numpy() @ (direction / length), 1.0, from_hand]
    return torch.from_numpy(token)
