"""One cloud in, one pose with a covariance and a confidence out.

estimator = PoseEstimator.load()
result = estimator.estimate(points, Category.HAMMER_HEAD, direction_to_rest, X_camera_hand)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose import confidence
from toolee_robot.perception.pose.canonical import MIN_POINTS, CanonicalCloud, canonicalize
from toolee_robot.perception.pose.network import CATEGORIES, CONTEXT_DIM, DIRECTION_DIM, PoseNet, sample
from toolee_robot.perception.pose.pooling import Pooled, pairwise_angles, pool
from toolee_robot.perception.pose.representation import T_SCALE, decode
from toolee_robot.perception.pose.spin import fix_spin, nominal_R_tool_ee, with_spin_variance
from toolee_robot.perception.pose.weights import Calibration, load
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.tools.model import ee_radius
from toolee_robot.types import Category, PoseHypotheses

CANDIDATES = 32
STEPS = 5
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
    features: the confidence model's input, see `confidence.FEATURES`.
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


class PoseEstimator:
    """Holds the network on one device. Not thread-safe only in torch's own sense: calls keep no state."""

    def __init__(self, net: PoseNet, calibration: Calibration | None = None, device: str = "cpu") -> None:
        self._net = net.to(device).eval()
        self.calibration = calibration or Calibration()
        self._device = torch.device(device)

    @classmethod
    def load(cls, weights_dir: Path | None = None, device: str = "cpu") -> PoseEstimator:
        """From the weights that ship with the package, or a folder. Raises AssetError if they are missing."""
        net, calibration = load(weights_dir)
        return cls(net, calibration, device)

    def estimate(
        self,
        points: Array,
        category: Category,
        direction_to_rest: Array | None = None,
        X_camera_hand: Array | None = None,
        seed: int = 0,
        candidates: int = CANDIDATES,
    ) -> PoseResult:
        """The pose of the EE whose visible points (N, 3) [m] are given in the camera's frame (OpenCV axes).

        direction_to_rest: (3,), from the EE's centroid toward the visible rest of the tool, camera axes, any length.
        X_camera_hand: 4x4, the hand that holds the tool; gives the direction where the first is missing, and the
        spin about a symmetric EE's axis. The same input and seed give the same result.
        Raises PerceptionError with fewer than 50 finite points.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        points = points[np.isfinite(points).all(1)]
        if len(points) < MIN_POINTS:
            raise PerceptionError(
                f"only {len(points)} points of the {category} have depth, {MIN_POINTS} are needed: "
                "move the camera closer, or turn the tool into view"
            )
        generator = torch.Generator().manual_seed(seed)
        visible = len(points)
        if visible > MAX_INPUT:
            points = points[torch.randperm(visible, generator=generator)[:MAX_INPUT].numpy()]
        cloud = canonicalize(
            torch.as_tensor(points, dtype=torch.float32)[None],
            torch.ones(1, len(points), dtype=torch.bool),
            torch.tensor([ee_radius(category)]),
            generator,
        )
        if int(cloud.count[0]) < MIN_POINTS:
            raise PerceptionError(
                f"the mask of the {category} covers no compact surface: {len(points)} scattered points"
            )
        kept = round(int(cloud.count[0]) / len(points) * visible)
        from_hand = direction_to_rest is None and X_camera_hand is not None
        if from_hand and X_camera_hand is not None:
            direction_to_rest = X_camera_hand[:3, 3] - cloud.centre[0].double().numpy()
        direction = direction_input(cloud, direction_to_rest, from_hand)
        with torch.inference_mode():
            result = self.infer(cloud, [category], direction, np.array([kept]), generator, candidates)[0]
        if X_camera_hand is not None:
            result = with_hand(result, X_camera_hand)
        return result

    def infer(
        self,
        cloud: CanonicalCloud,
        categories: list[Category],
        direction: torch.Tensor,
        visible: Array,
        generator: torch.Generator,
        candidates: int = CANDIDATES,
    ) -> list[PoseResult]:
        """Encode, sample and pool a batch of canonical clouds; direction (B, 5) as `direction_input` makes it.

        visible: (B,) how many points were seen. The generator lives on the CPU. No spin fix."""
        device = self._device
        index = torch.tensor([CATEGORIES.index(c) for c in categories], device=device)
        context = context_input(cloud, torch.as_tensor(visible))
        feature = self._net.encode(cloud.points.to(device), index, direction.to(device), context.to(device))
        u = sample(self._net, feature, candidates, generator, STEPS)
        regression = {k: v.cpu() for k, v in self._net.regress(feature).items()}
        R, p, ambiguous = (x.double().numpy() for x in decode(u.float().cpu()))
        R_direct, p_direct, _ = (x.double().numpy() for x in decode(regression["mean"]))
        sigmas = regression["log_sigma"].double().exp().numpy() * [T_SCALE, 1.0, 1.0]
        valid = regression["valid"].double().numpy()
        R_camera = np.swapaxes(cloud.R.cpu().double().numpy(), 1, 2)
        centre = cloud.centre.cpu().double().numpy()
        local = cloud.points.cpu().double().numpy()
        results = []
        for b, category in enumerate(categories):
            Xs = np.tile(np.eye(4), (candidates, 1, 1))
            Xs[:, :3, :3] = R_camera[b] @ R[b]
            Xs[:, :3, 3] = p[b] @ R_camera[b].T + centre[b]
            X_direct = transform(R_camera[b] @ R_direct[b], R_camera[b] @ p_direct[b] + centre[b])
            axis_index = int(np.argmax(category.symmetry.axis))
            # Half from the samples' S, half from the regression's.
            spin_free = float(np.clip(ambiguous[b, :, axis_index].mean(), 0, 1))
            logit = float(regression["mean"][b, 6 + axis_index])
            spin_free = 0.5 * spin_free + 0.5 / (1 + float(np.exp(-np.clip(logit, -30, 30))))
            points = local[b] @ R_camera[b].T + centre[b]
            results.append(
                self._result(category, Xs, X_direct, sigmas[b], 1 - spin_free, int(visible[b]), float(valid[b]), points)
            )
        return results

    def _result(
        self,
        category: Category,
        Xs: Array,
        X_direct: Array,
        sigmas: Array,
        spin_observable: float,
        visible: int,
        valid: float,
        points: Array,
    ) -> PoseResult:
        group = category.symmetry
        scale = self.calibration.scales[category]
        pooled = pool(Xs, group, float(sigmas[0]), float(sigmas[1]), float(sigmas[2]), spin_observable, scale)
        x = confidence.features(category, pooled, sigmas, visible, valid, *_disagreement(pooled, X_direct, category))
        model = self.calibration.confidence
        probability = float(model.probability(x))
        usable = probability >= model.threshold
        hypotheses = PoseHypotheses(Xs, points, float(sigmas[0]), float(sigmas[1]), spin_observable)
        reason = confidence.reason(category, x, usable)
        return PoseResult(
            category, pooled.X, pooled.covariance, probability, usable, reason, hypotheses, pooled.modes, x
        )


def with_hand(result: PoseResult, X_camera_hand: Array, spin_sigma: float = HAND_SPIN_SIGMA) -> PoseResult:
    """The result with the spin about a symmetric EE's axis fixed by the hand's pose (4x4); see `spin.py`."""
    from toolee_robot.robots.grasp import nominal_X_hand_tool

    group = result.category.symmetry
    R_hand_ee = nominal_X_hand_tool(0.015)[:3, :3] @ nominal_R_tool_ee(result.category)
    R = result.X_camera_ee[:3, :3]
    axis = R @ np.asarray(group.axis)
    variance = float(axis @ result.covariance[3:, 3:] @ axis)
    R_fixed, fixed_variance = fix_spin(R, X_camera_hand[:3, :3] @ R_hand_ee, group, variance, spin_sigma**2)
    covariance = result.covariance
    if group.kind is SymmetryKind.CINF:
        covariance = with_spin_variance(covariance, axis, fixed_variance)
    X = transform(R_fixed, result.X_camera_ee[:3, 3])
    return PoseResult(**{**result.__dict__, "X_camera_ee": X, "covariance": covariance})


def direction_input(cloud: CanonicalCloud, direction: Array | None, from_hand: bool = False) -> torch.Tensor:
    """The network's direction token (1, 5) from a direction (3,) in the camera's frame, or None."""
    token = torch.zeros(1, DIRECTION_DIM)
    if direction is not None and np.isfinite(direction).all() and np.linalg.norm(direction) > 1e-6:
        d = torch.as_tensor(direction / np.linalg.norm(direction), dtype=torch.float32)
        token[0, :3] = cloud.R[0].cpu() @ d
        token[0, 3] = 1.0
        token[0, 4] = float(from_hand)
    return token


def context_input(cloud: CanonicalCloud, visible: torch.Tensor) -> torch.Tensor:
    """The network's context token (B, 2): number of visible points, distance."""
    count = visible.to(cloud.centre).clamp(1, 10_000).log10() - 2.5
    context = torch.stack([count, cloud.centre.norm(dim=-1) - 0.7], dim=-1)
    assert context.shape[-1] == CONTEXT_DIM
    return context


def _disagreement(pooled: Pooled, X_direct: Array, category: Category) -> tuple[float, float]:
    """Distance [m] and angle [rad], modulo the group, between the pooled samples and the direct regression."""
    R = np.stack([pooled.X[:3, :3], X_direct[:3, :3]])
    angle = float(pairwise_angles(R, category.symmetry)[0, 1])
    return float(np.linalg.norm(pooled.X[:3, 3] - X_direct[:3, 3])), angle
