"""The default pose estimator: from one cloud to one pose with a covariance and a confidence.

estimator = PoseEstimator.load()
result = estimator.estimate(points, Category.HAMMER_HEAD, rest, hand)
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import torch

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, transform
from toolee_robot.perception.pose import confidence
from toolee_robot.perception.pose.canonical import CanonicalCloud
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator, PoseResult
from toolee_robot.perception.pose.network import CONTEXT_DIM, REGRESSED, SAMPLER, PoseNet, Seen
from toolee_robot.perception.pose.pooling import Pooled, pairwise_angles, pool
from toolee_robot.perception.pose.processes import Euler, Sampler
from toolee_robot.perception.pose.representation import DIM, T_SCALE, decode, mirrored
from toolee_robot.perception.pose.weights import Calibration, load
from toolee_robot.perception.precision import CudaGraphRunner, prefers_bfloat16, single_thread, torch_device
from toolee_robot.types import PoseHypotheses

NEAREST = 0.45
"""A nearer cloud is told to the network as one at this distance [m]. Its clouds begin at 0.35 m, and short of that the
confidence collapses while the pose stays right: half A of the photographs, at 0.30 to 0.35 m."""


class PoseEstimator(CloudEstimator):
    """Pose estimator with the network of `network.py`, on one device.

    Args:
        net: The trained network.
        calibration: Scales of the covariance and the confidence model; None: unfitted, nothing is usable.
        device: torch device that runs the network.
        sampler: Solves the generative process from noise to candidate poses.
        bfloat16: Whether a CPU encodes clouds in bfloat16; None: where it is faster, see `prefers_bfloat16`.

    Attributes:
        calibration: As given.
        process: Generative process that the network was trained for.
        sampler: As given.
    """

    def __init__(
        self,
        net: PoseNet,
        calibration: Calibration | None = None,
        device: str = "cpu",
        sampler: Sampler = SAMPLER,
        bfloat16: bool | None = None,
    ) -> None:
        self._device = torch_device(device)
        self._bfloat16 = prefers_bfloat16(self._device) if bfloat16 is None else bfloat16
        if self._bfloat16:
            net = copy.deepcopy(net)
            net.encoder_in_bfloat16()
        self._net = net.to(device).eval()
        self.calibration = calibration or Calibration()
        self.process, self.sampler = net.process, sampler
        self._graph_runners: dict[Sampler, CudaGraphRunner] = {}

    @classmethod
    def load(cls, weights_dir: Path | None = None, device: str = "cpu") -> PoseEstimator:
        """Load the trained estimator.

        Args:
            weights_dir: Folder of weights; None: the shipped ones.
            device: torch device that runs the network.

        Returns:
            The estimator, ready.

        Raises:
            AssetError: The weights are missing or unreadable.
        """
        net, calibration = load(weights_dir)
        return cls(net, calibration, device)

    def infer(
        self,
        cloud: CanonicalCloud,
        categories: list[Category],
        direction: torch.Tensor,
        visible: Array,
        generator: torch.Generator,
        candidates: int,
    ) -> list[PoseResult]:
        """See `CloudEstimator.infer`."""
        run, device = self._pass(alone=len(categories) == 1)
        index = torch.tensor([CATEGORIES.index(c) for c in categories], device=device)
        context = context_input(cloud, torch.as_tensor(visible))
        # The generator lives on the CPU: the same seed gives the same draws on any device.
        noise = torch.randn(len(categories), candidates, DIM, generator=generator).to(device)
        # One thread: a single cloud gains 20 % from a second one, and takes twice as long when its core is busy.
        with single_thread() if self._bfloat16 and len(categories) == 1 else nullcontext():
            u, *direct = (x.float().cpu() for x in run(*Seen.of(cloud, index, direction, context), noise))
        regression = dict(zip(REGRESSED, direct, strict=True))
        # Decode the candidates and, as one more, the regressed pose.
        R, p, ambiguous = (x.double().numpy() for x in decode(torch.cat([u, regression["mean"][:, None]], 1)))
        ambiguous = ambiguous[:, :-1].mean(1)
        sigmas = regression["log_sigma"].double().exp().numpy() * [T_SCALE, 1.0, 1.0]
        valid = regression["valid"].double().numpy()
        R_camera = np.swapaxes(cloud.R.cpu().double().numpy(), 1, 2)
        centre = cloud.centre.cpu().double().numpy()
        local = cloud.points.cpu().double().numpy()
        results = []
        for b, category in enumerate(categories):
            Xs = np.zeros((candidates, 4, 4))
            Xs[:, 3, 3] = 1.0
            Xs[:, :3, :3] = R_camera[b] @ R[b, :-1]
            Xs[:, :3, 3] = p[b, :-1] @ R_camera[b].T + centre[b]
            X_direct = transform(R_camera[b] @ R[b, -1], R_camera[b] @ p[b, -1] + centre[b])
            axis = category.symmetry.axis
            axis_index = axis.index(max(axis))
            # Mean of the samples' ambiguity S and the regressed one.
            spin_free = min(max(float(ambiguous[b, axis_index]), 0.0), 1.0)
            logit = min(max(float(regression["mean"][b, 6 + axis_index]), -30.0), 30.0)
            spin_free = 0.5 * spin_free + 0.5 / (1 + math.exp(-logit))
            points = local[b] @ R_camera[b].T + centre[b]
            hypotheses = PoseHypotheses(Xs, points, float(sigmas[b, 0]), float(sigmas[b, 1]), 1 - spin_free)
            results.append(
                self._result(category, hypotheses, X_direct, sigmas[b], int(visible[b]), float(valid[b]), ambiguous[b])
            )
        return results

    def _pass(self, alone: bool) -> tuple[Callable[..., tuple[torch.Tensor, ...]], torch.device]:
        """The function that runs `_network`, and the device on which it takes its inputs.

        A single cloud on a GPU runs as a recorded CUDA graph. Adaptive solvers (RK45) cannot be recorded: their steps
        depend on values.
        """
        if not (alone and self._device.type == "cuda" and isinstance(self.sampler, Euler)):
            return self._network, self._device
        if self.sampler not in self._graph_runners:
            self._graph_runners[self.sampler] = CudaGraphRunner(self._network, self._device)
        return self._graph_runners[self.sampler], torch.device("cpu")

    def _network(self, *inputs: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Encode the clouds, sample candidates and regress.

        Half of the candidates are sampled from the cloud and half from its mirror image, whose errors differ; sigmas
        and validity are the means of both, the regressed pose is the cloud's own.

        Args:
            *inputs: The fields of `Seen`, then standard normal noise (B, K, 12).

        Returns:
            Candidates u (B, K, 12), then `REGRESSED`: mean (B, 12), log_sigma (B, 3), valid (B,).
        """
        *fields, noise = inputs
        B, K = noise.shape[:2]
        half = (K + 1) // 2
        feature = self._net.encode(Seen(*fields), mirror=True)
        condition = self._net.flow.condition(feature)
        drawn = self.sampler(
            self.process,
            lambda u, t: self._net.flow(u, t, condition),
            torch.cat([noise[:, :half], noise[:, K - half :]]),
        )
        u = torch.cat([drawn[:B], mirrored(drawn[B:, 2 * half - K :])], 1)
        regression = self._net.regress(feature)
        mean, log_sigma, valid = (torch.stack(regression[name].chunk(2)) for name in REGRESSED)
        return u, mean[0], log_sigma.mean(0), valid.mean(0)

    def _result(
        self,
        category: Category,
        hypotheses: PoseHypotheses,
        X_direct: Array,
        sigmas: Array,
        visible: int,
        valid: float,
        ambiguous: Array,
    ) -> PoseResult:
        """Pool the candidates of one cloud, scale the covariance, and rate the result with the confidence model."""
        scale = self.calibration.scales[category]
        Xs, spin_observable = hypotheses.Xs_camera_ee, hypotheses.spin_observable
        sigma_position, sigma_axis, sigma_spin = (float(s) for s in sigmas)
        pooled = pool(Xs, category.symmetry, sigma_position, sigma_axis, sigma_spin, spin_observable, scale)
        x = confidence.features(category, pooled, sigmas, visible, valid, *_disagreement(pooled, X_direct, category))
        model = self.calibration.confidence
        probability = float(model.probability(x))
        usable = probability >= model.threshold
        reason = confidence.reason(category, x, usable)
        X, covariance = pooled.X, pooled.covariance
        return PoseResult(category, X, covariance, probability, usable, reason, hypotheses, x, ambiguous)


def context_input(cloud: CanonicalCloud, visible: torch.Tensor) -> torch.Tensor:
    """The network's context token.

    Args:
        cloud: Canonical clouds, a batch of B.
        visible: Number of visible points of each cloud, (B,).

    Returns:
        (B, 2): log10 of the number of visible points - 2.5, and distance [m], at least NEAREST, - 0.7.
    """
    count = visible.to(cloud.centre).clamp(1, 10_000).log10() - 2.5
    context = torch.stack([count, cloud.centre.norm(dim=-1).clamp_min(NEAREST) - 0.7], dim=-1)
    assert context.shape[-1] == CONTEXT_DIM
    return context


def _disagreement(pooled: Pooled, X_direct: Array, category: Category) -> tuple[float, float]:
    """Distance [m] and angle [rad], modulo the group, between the pooled samples and the direct regression."""
    R = np.stack([pooled.X[:3, :3], X_direct[:3, :3]])
    angle = float(pairwise_angles(R, category.symmetry)[0, 1])
    return float(np.linalg.norm(pooled.X[:3, 3] - X_direct[:3, 3])), angle
