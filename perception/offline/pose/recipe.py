"""How the pose network is trained: its clouds, its loss, the estimator that results and its calibration."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from toolee_robot.perception.offline.pose import validation
from toolee_robot.perception.offline.pose.losses import augment, pose_loss, without_rest
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch, CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.generator import CloudGenerator
from toolee_robot.perception.offline.synthetic_clouds.rendered import RenderedClouds, RenderedSource
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import Float32, SurfaceSamples
from toolee_robot.perception.pose import weights
from toolee_robot.perception.pose.estimator import PoseEstimator
from toolee_robot.perception.pose.network import SAMPLER, NetworkConfig, PoseNet
from toolee_robot.perception.pose.processes.flow import Sampler
from toolee_robot.perception.pose.processes.registry import PROCESSES
from toolee_robot.perception.pose.weights import Calibration


@dataclass(frozen=True)
class DefaultRecipe:
    """The recipe of `PoseNet`.

    Attributes:
        config: Architecture of the network.
        clouds_config: Distributions of the synthetic clouds.
        draws: Noise draws per cloud.
        rest_dropout: Share of the clouds whose rest of the tool is withheld.
        direction_dropout: Share of those whose direction to it is withheld, too.
        augmentation: Whether clouds are rolled and mirrored at random.
        sampler: Solver used in the evaluation.
        name: Name of the weight files.
    """

    config: NetworkConfig = field(default_factory=NetworkConfig)
    clouds_config: CloudConfig = field(default_factory=CloudConfig)
    draws: int = 8
    rest_dropout: float = 0.35
    direction_dropout: float = 0.5
    augmentation: bool = True
    sampler: Sampler = SAMPLER
    name: str = weights.NAME

    def clouds(self, samples: SurfaceSamples, hands: Float32, device: torch.device, seed: int) -> CloudGenerator:
        """A generator of training or held-out clouds."""
        return CloudGenerator(samples, hands, device, seed, self.clouds_config)

    def rendered(self, clouds: RenderedClouds, device: torch.device, seed: int) -> RenderedSource:
        """A source of stored clouds of rendered images."""
        return RenderedSource(clouds, device, seed, self.clouds_config)

    def network(self) -> PoseNet:
        """A new network."""
        return PoseNet(self.config)

    def prepare(self, batch: CloudBatch, generator: torch.Generator) -> CloudBatch:
        """A batch as it is shown in training, augmented."""
        batch = without_rest(batch, self.rest_dropout, self.direction_dropout, generator)
        return augment(batch, generator) if self.augmentation else batch

    def loss(self, net: nn.Module, batch: CloudBatch, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of a batch, and its parts by name."""
        return pose_loss(net, batch, self.draws, generator, PROCESSES[self.config.process])

    def estimator(self, net: PoseNet, calibration: Calibration, device: str) -> PoseEstimator:
        """The estimator with the trained network."""
        return PoseEstimator(net, calibration, device, self.sampler)

    def report(
        self, net: PoseNet, held_out: CloudBatch, samples: SurfaceSamples, device: str
    ) -> tuple[dict[str, Any], Calibration]:
        """Metrics on held-out clouds, and the calibration: fitted on half of the tools, reported on the others."""
        estimator = self.estimator(net, Calibration(), device)
        K = estimator.candidates
        result = validation.evaluate(estimator, held_out, K)
        no_rest = validation.without_rest(held_out)
        none = validation.without_direction(no_rest)
        near = (held_out.distance < 0.75).cpu().numpy() & (held_out.occlusion < 0.2).cpu().numpy()
        report: dict[str, Any] = {
            f"K{K}": validation.metrics(result),
            f"K{K}_near_unoccluded": validation.metrics(result, near),
            f"K{K}_no_rest": validation.metrics(validation.evaluate(estimator, no_rest, K)),
            f"K{K}_no_direction": validation.metrics(validation.evaluate(estimator, none, K)),
        }
        fit, test = (_half(held_out, samples, result, parity) for parity in (0, 1))
        calibration = validation.calibrate(fit)
        report["confidence"] = validation.confidence_report(test, calibration)
        report["clouds"] = asdict(self.clouds_config)
        return report, calibration

    def save(self, folder: Path, net: PoseNet, calibration: Calibration, report: dict[str, Any]) -> None:
        """Write the weights with their description."""
        weights.save(folder, net, calibration, report, self.name)

    def load(self, folder: Path) -> PoseNet:
        """The network that `save` wrote. Raises AssetError when it is missing or unreadable."""
        return weights.load(folder, self.name)[0]


def _half(
    batch: CloudBatch, samples: SurfaceSamples, evaluated: validation.Evaluated, parity: int
) -> validation.Evaluated:
    """The clouds of every second tool; by tool, so that a hammer's claw and head stay together."""
    chosen = np.flatnonzero(samples.tools[evaluated.item] % 2 == parity)
    index = torch.as_tensor(chosen, device=batch.points.device)
    return validation.Evaluated(batch.select(index), [evaluated.results[i] for i in chosen])
