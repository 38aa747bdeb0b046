"""Training recipe of the paper's estimator in the project's training loop: the same clouds, the same budget."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from toolee_robot.perception.offline.pose import validation
from toolee_robot.perception.offline.research.tooleenet import object_clouds
from toolee_robot.perception.offline.research.tooleenet.estimator import (
    COLUMNS,
    NAME,
    OBJECT_RADIUS,
    POINTS,
    PROCESS,
    Column,
    PaperEstimator,
    in_camera,
    load,
    save,
)
from toolee_robot.perception.offline.research.tooleenet.network import PaperNet
from toolee_robot.perception.offline.research.tooleenet.pointnet2 import ORDERED
from toolee_robot.perception.offline.research.tooleenet.representation import class_ambiguity, encode
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch, CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.generator import CloudGenerator
from toolee_robot.perception.offline.synthetic_clouds.rendered import RenderedClouds, RenderedSource
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import Float32, SurfaceSamples
from toolee_robot.perception.pose.weights import Calibration


@dataclass(frozen=True)
class PaperRecipe:
    """The `TrainingRecipe` of the paper's estimator.

    Attributes:
        column: The column of Table I.
        clouds_config: Distributions of the synthetic clouds.
        draws: Noise draws per encoded cloud, 20 as in the published code.
        name: Name of the weight files.
    """

    column: Column = COLUMNS["symmetry-aware"]
    clouds_config: CloudConfig = field(default_factory=CloudConfig)
    draws: int = 20
    name: str = NAME

    @property
    def of_tool(self) -> bool:
        """See `TrainingRecipe`."""
        return self.column.of_tool

    def clouds(self, samples: SurfaceSamples, hands: Float32, device: torch.device, seed: int) -> CloudGenerator:
        """See `TrainingRecipe`: clouds of the EE, or of the whole tool, with as many points as the paper's."""
        make = object_clouds.ObjectCloudGenerator if self.of_tool else CloudGenerator
        return make(samples, hands, device, seed, self._seen)

    def rendered(self, clouds: RenderedClouds, device: torch.device, seed: int) -> RenderedSource:
        """See `TrainingRecipe`: no negatives."""
        config = replace(self._seen, negative_share=0.0, radius=OBJECT_RADIUS if self.of_tool else None)
        return RenderedSource(clouds, device, seed, config)

    @property
    def _seen(self) -> CloudConfig:
        return replace(self.clouds_config, points=POINTS, ordered=ORDERED, rest=False, guessed=False)

    def network(self, samples: SurfaceSamples) -> PaperNet:
        """See `TrainingRecipe`; with the priors of the training tools."""
        net = PaperNet(self.column.dim)
        net.X_tool_ee.copy_(torch.as_tensor(object_clouds.category_priors(samples)).half())
        return net

    def prepare(self, batch: CloudBatch, generator: torch.Generator) -> CloudBatch:  # noqa: ARG002 - as the protocol
        """See `TrainingRecipe`; no augmentation."""
        return batch

    def loss(self, net: nn.Module, batch: CloudBatch, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """Denoising score matching, weighted by sigma^2, over the positives.

        Args:
            net: The network.
            batch: The clouds.
            generator: Random generator, on the clouds' device.

        Returns:
            The loss, and its parts by name.
        """
        R_camera = batch.R_canonical.mT @ batch.R
        p_camera = torch.einsum("bji,bj->bi", batch.R_canonical, batch.p) + batch.centre
        S = class_ambiguity().to(batch.points)[batch.category] if self.column.predicts_ambiguity else None
        noised = PROCESS.noised(encode(R_camera, p_camera, S), self.draws, generator)
        # Computed outside of autocast: half precision is too coarse for coordinates.
        points = in_camera(batch.cloud)
        device = points.device.type
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            predicted = net(points, noised.u, noised.t)
        positive = batch.positive.float()
        error = (predicted.float() - noised.goal).square().sum(-1).mean(1)
        loss = (error * positive).sum() / positive.sum().clamp_min(1)
        return loss, {"loss": loss.detach()}

    def estimator(self, net: PaperNet, calibration: Calibration, device: str) -> PaperEstimator:  # noqa: ARG002
        """See `TrainingRecipe`; there is no calibration."""
        return PaperEstimator(net, self.column, device)

    def with_ee_truth(self, batch: CloudBatch, samples: SurfaceSamples) -> CloudBatch:
        """See `TrainingRecipe`."""
        return object_clouds.with_ee_truth(batch, samples) if self.of_tool else batch

    def report(
        self,
        net: PaperNet,
        held_out: CloudBatch,
        samples: SurfaceSamples,  # noqa: ARG002 - others need it
        device: str,
    ) -> tuple[dict[str, Any], Calibration]:
        """See `TrainingRecipe`."""
        result = validation.evaluate(self.estimator(net, Calibration(), device), held_out, PaperEstimator.candidates)
        report = {"K20": validation.metrics(result), "column": self.column.name, "clouds": asdict(self.clouds_config)}
        return report, Calibration()

    def save(self, folder: Path, net: PaperNet, calibration: Calibration, report: dict[str, Any]) -> None:  # noqa: ARG002
        """See `TrainingRecipe`."""
        save(folder, net, self.column, report)

    def load(self, folder: Path) -> PaperNet:
        """See `TrainingRecipe`."""
        return load(folder)[0]
