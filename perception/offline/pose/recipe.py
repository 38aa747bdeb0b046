"""Training recipes: a network, its clouds, its loss, and the estimator that results.

The trainer knows only `TrainingRecipe`; `DefaultRecipe` is the project's, `research.tooleenet.PaperRecipe` the paper's.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

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
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator
from toolee_robot.perception.pose.estimator import PoseEstimator
from toolee_robot.perception.pose.network import SAMPLER, NetworkConfig, PoseNet
from toolee_robot.perception.pose.processes.flow import Sampler
from toolee_robot.perception.pose.processes.registry import PROCESSES
from toolee_robot.perception.pose.weights import Calibration

Net = TypeVar("Net", bound=nn.Module)


class TrainingRecipe(Protocol, Generic[Net]):
    """Everything needed to train a network, to evaluate it and to store it."""

    @property
    def name(self) -> str:
        """Name of the weight files."""

    @property
    def of_tool(self) -> bool:
        """Whether it learns from clouds of whole tools instead of end effectors."""

    def clouds(self, samples: SurfaceSamples, hands: Float32, device: torch.device, seed: int) -> CloudGenerator:
        """A generator of training or held-out clouds.

        Args:
            samples: Surface samples of the tools.
            hands: Surface samples of hands, (H, 6144, 3) [m].
            device: torch device.
            seed: Seed of the clouds.

        Returns:
            The generator.
        """

    def rendered(self, clouds: RenderedClouds, device: torch.device, seed: int) -> RenderedSource:
        """A source of clouds of rendered images, of the kind that the recipe learns from.

        Args:
            clouds: The stored clouds.
            device: torch device.
            seed: Seed of the draws.

        Returns:
            The source.
        """

    def network(self, samples: SurfaceSamples) -> Net:
        """A new network; `samples`: surface samples of the training tools."""

    def prepare(self, batch: CloudBatch, generator: torch.Generator) -> CloudBatch:
        """A batch as it is shown in training, augmented where the recipe does so.

        Args:
            batch: The clouds.
            generator: Random numbers, on the clouds' device.

        Returns:
            The clouds.
        """

    def loss(self, net: nn.Module, batch: CloudBatch, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of a batch.

        Args:
            net: The network, possibly compiled.
            batch: The clouds.
            generator: Random numbers, on the clouds' device.

        Returns:
            The loss, and its parts by name.
        """

    def estimator(self, net: Net, calibration: Calibration, device: str) -> CloudEstimator:
        """The estimator with the trained network.

        Args:
            net: The network.
            calibration: Its calibration.
            device: torch device.

        Returns:
            The estimator.
        """

    def with_ee_truth(self, batch: CloudBatch, samples: SurfaceSamples) -> CloudBatch:
        """Held-out clouds with the EE's pose as truth, whatever the network estimates.

        Args:
            batch: The clouds.
            samples: Surface samples of their tools.

        Returns:
            The clouds.
        """

    def report(
        self, net: Net, held_out: CloudBatch, samples: SurfaceSamples, device: str
    ) -> tuple[dict[str, Any], Calibration]:
        """Evaluate and calibrate the network on held-out clouds.

        Args:
            net: The trained network.
            held_out: The clouds.
            samples: Surface samples of their tools.
            device: torch device.

        Returns:
            Metrics, and the calibration.
        """

    def save(self, folder: Path, net: Net, calibration: Calibration, report: dict[str, Any]) -> None:
        """Write the weights with their description.

        Args:
            folder: Output folder.
            net: The trained network.
            calibration: Its calibration.
            report: Record of the training.
        """

    def load(self, folder: Path) -> Net:
        """The network that `save` wrote. Raises AssetError when it is missing or unreadable."""


@dataclass(frozen=True)
class DefaultRecipe:
    """The recipe of `PoseNet`.

    Attributes:
        config: Architecture of the network.
        clouds_config: Distributions of the synthetic clouds.
        draws: Noise draws per cloud.
        rest_dropout: Share of the clouds whose rest of the tool is withheld.
        direction_dropout: Share of those whose direction to it is withheld, too; 1: also in the evaluation.
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

    @property
    def of_tool(self) -> bool:
        """See `TrainingRecipe`."""
        return False

    def clouds(self, samples: SurfaceSamples, hands: Float32, device: torch.device, seed: int) -> CloudGenerator:
        """See `TrainingRecipe`."""
        return CloudGenerator(samples, hands, device, seed, self.clouds_config)

    def rendered(self, clouds: RenderedClouds, device: torch.device, seed: int) -> RenderedSource:
        """See `TrainingRecipe`."""
        return RenderedSource(clouds, device, seed, self.clouds_config)

    def network(self, samples: SurfaceSamples) -> PoseNet:  # noqa: ARG002 - others need it
        """See `TrainingRecipe`."""
        return PoseNet(self.config)

    def prepare(self, batch: CloudBatch, generator: torch.Generator) -> CloudBatch:
        """See `TrainingRecipe`."""
        batch = without_rest(batch, self.rest_dropout, self.direction_dropout, generator)
        return augment(batch, generator) if self.augmentation else batch

    def loss(self, net: nn.Module, batch: CloudBatch, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """See `TrainingRecipe`."""
        return pose_loss(net, batch, self.draws, generator, PROCESSES[self.config.process])

    def estimator(self, net: PoseNet, calibration: Calibration, device: str) -> PoseEstimator:
        """See `TrainingRecipe`."""
        return PoseEstimator(net, calibration, device, self.sampler)

    def with_ee_truth(self, batch: CloudBatch, samples: SurfaceSamples) -> CloudBatch:  # noqa: ARG002 - others need it
        """See `TrainingRecipe`."""
        if self.rest_dropout == 1:
            batch = validation.without_rest(batch)
        return batch if self.direction_dropout < 1 else validation.without_direction(batch)

    def report(
        self, net: PoseNet, held_out: CloudBatch, samples: SurfaceSamples, device: str
    ) -> tuple[dict[str, Any], Calibration]:
        """See `TrainingRecipe`; the calibration is fitted on one half of the tools and reported on the other."""
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
        """See `TrainingRecipe`."""
        weights.save(folder, net, calibration, report, self.name)

    def load(self, folder: Path) -> PoseNet:
        """See `TrainingRecipe`."""
        return weights.load(folder, self.name)[0]


def _half(
    batch: CloudBatch, samples: SurfaceSamples, evaluated: validation.Evaluated, parity: int
) -> validation.Evaluated:
    """The clouds of every second tool; by tool, so that a hammer's claw and head stay together."""
    chosen = np.flatnonzero(samples.tools[evaluated.item] % 2 == parity)
    index = torch.as_tensor(chosen, device=batch.points.device)
    return validation.Evaluated(batch.select(index), [evaluated.results[i] for i in chosen])
