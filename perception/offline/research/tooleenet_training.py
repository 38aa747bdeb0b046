"""Training of one column of the paper's Table I, as its published code trains: `toolee train paper`.

Every epoch shows each stored cloud once, un-centred and without augmentation; the translation to learn is from the
cloud's mean. A cloud never changes, so its farthest-point samples and the balls around them are found once and stay on
the device. Order and noise depend on the seed and the step alone: an interrupted training gives the weights of one
without a break.

One thing differs from the published code: batch normalisation keeps its statistics from an epoch on
(`freeze_batchnorm` says why).
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from toolee_robot.end_effectors import Category
from toolee_robot.errors import TooleeError, UserError
from toolee_robot.frames import Array, inverse
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.rendered import RenderedClouds, RenderedSource
from toolee_robot.perception.offline.training import pose_validation as validation
from toolee_robot.perception.offline.training.loop import Distributed, TrainingRun, init_distributed, with_weights
from toolee_robot.perception.offline.training.options import TrainingOptions
from toolee_robot.perception.pose.tooleenet.estimator import (
    COLUMNS,
    NAME,
    OBJECT_RADIUS,
    PROCESS,
    Column,
    PaperEstimator,
    class_ambiguity,
    encode,
    in_camera,
    load,
    mean_pose,
    save,
)
from toolee_robot.perception.pose.tooleenet.network import ORDERED, POINTS, PaperNet

_CHUNK = 512
"""Clouds that are prepared at a time."""


@dataclass(frozen=True, kw_only=True)
class PaperOptions(TrainingOptions):
    """The options of a column's training; the defaults are the published code's.

    Attributes:
        minutes: See `TrainingOptions`, as all that are not explained here.
        batch: Clouds per step.
        warmup_steps: Steps over which the learning rate rises.
        weight_decay: None.
        clip_norm: Largest norm of the gradient.
        epochs: Budget: how often each cloud is shown.
        decay: Factor on the learning rate from epoch to epoch.
        least_lr: Lowest learning rate.
        draws: Noise draws per encoded cloud.
        freeze_epochs: Epochs after which batch normalisation keeps its statistics.
        judged: Clouds that are kept aside and judged at each checkpoint: seen tools in images that are not seen.
    """

    USUAL_MINUTES: ClassVar[float] = float("inf")
    """Minutes of a training that are usual: the epochs end it."""

    batch: int = 600
    warmup_steps: int = 100
    weight_decay: float = 0.0
    clip_norm: float = 1.0
    epochs: int = 2000
    decay: float = 0.98
    least_lr: float = 1e-4
    draws: int = 20
    freeze_epochs: int = 40
    judged: int = 1024


@dataclass(frozen=True, eq=False)
class PreparedClouds:
    """N clouds as the network takes them.

    Attributes:
        points: (N, 1024, 3) [m], camera frame, farthest-point samples first.
        neighbours: `PointNet2.neighbours` of them.
        target: Pose vectors, (N, dim).
    """

    points: Tensor
    neighbours: tuple[Tensor, ...]
    target: Tensor

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of(
        cls, net: PaperNet, column: Column, clouds: RenderedClouds, source: RenderedSource, numbers: Tensor
    ) -> PreparedClouds:
        """Prepare clouds.

        Args:
            net: The network.
            column: Its column.
            clouds: The stored clouds.
            source: The same, on the device.
            numbers: Numbers of those to prepare, on the device; those that show too little are left out.

        Returns:
            The prepared clouds, on the device.
        """
        parts: list[tuple[Tensor, ...]] = []
        for some in torch.split(numbers, _CHUNK):
            batch = source.rows(some)
            points, which = in_camera(batch.cloud), batch.item.cpu().numpy()
            X = torch.as_tensor((clouds.X_camera_tool if column.of_tool else clouds.X_camera_ee)[which])
            S = class_ambiguity()[batch.category.cpu()] if column.predicts_ambiguity else None
            target = encode(X[:, :3, :3], X[:, :3, 3] - points.mean(1).cpu(), S).to(points)
            parts.append((points, target, *net.encoder.neighbours(points)))
        points, target, *neighbours = (torch.cat(each) for each in zip(*parts, strict=True))
        return cls(points, tuple(neighbours), target)

    def rows(self, which: Tensor) -> tuple[Tensor, list[Tensor], Tensor]:
        """Points, neighbours and targets of clouds (B,)."""
        return self.points[which], [near[which] for near in self.neighbours], self.target[which]


class ColumnTraining(TrainingRun):
    """The training of one column.

    Args:
        out: Folder for checkpoint, weights and log.
        options: Options of the training.
        column: The column.
        clouds: Clouds of end effectors, or of whole tools where the column takes these.
        distributed: The device.
    """

    name = NAME
    log_seconds = 15.0
    averages_buffers = False

    def __init__(
        self,
        out: Path,
        options: PaperOptions,
        column: Column,
        clouds: RenderedClouds,
        distributed: Distributed,
    ) -> None:
        torch.manual_seed(options.seed)
        self.options, self.column, device = options, column, distributed.device
        self.net = PaperNet(column.dim).to(device)
        self.net.X_tool_ee.copy_(torch.as_tensor(category_priors(clouds)).half())
        source = paper_source(clouds, column, device, options.seed)
        numbers = torch.arange(len(clouds), device=device)
        shown, judged = numbers.tensor_split([max(len(clouds) - options.judged, 0)])
        self.clouds = PreparedClouds.of(self.net, column, clouds, source, shown)
        self._judged = source.rows(judged)
        if len(self.clouds) < options.batch:
            raise UserError(
                f"{len(self.clouds)} clouds are fewer than a batch of {options.batch}: take more images",
                code="user.too_few_images",
            )
        self.steps_per_epoch = len(self.clouds) // options.batch
        self._generator = torch.Generator(device)
        self._order: tuple[int, Tensor] | None = None
        super().__init__(options, out, distributed, self.net, self.net)

    def start_from(self, folder: Path) -> None:
        """Start from the weights of another training of this column."""
        net, column = load(folder)
        if column != self.column:
            raise UserError(f"--init {folder}: it is of the column {column.name}, this training of {self.column.name}")
        self.net.load_state_dict(net.state_dict())
        self.average = {k: v.detach().clone() for k, v in self.net.state_dict().items()}

    @property
    def epoch(self) -> int:
        """Number of the epoch of the next step, from 0."""
        return self.step // self.steps_per_epoch

    @property
    def progress(self) -> float:
        """Share of the epochs, or of the minutes if they are given."""
        return max(self.step / (self.options.epochs * self.steps_per_epoch), super().progress)

    def schedule(self, progress: float) -> float:  # noqa: ARG002 - the rate falls by epochs, whatever the budget
        """See `TrainingRun`."""
        return max(self.options.decay**self.epoch, self.options.least_lr / self.options.lr)

    def make_optimizer(self) -> torch.optim.Optimizer:
        """Adam without decay."""
        return torch.optim.Adam(self.net.parameters(), self.options.lr, fused=self.distributed.device.type == "cuda")

    def prepare(self) -> nn.Module:
        """Compile the network on a GPU."""
        if not (self.options.compile and self.distributed.device.type == "cuda"):
            return self.net
        compiled: nn.Module = torch.compile(self.net)  # type: ignore[assignment]
        return compiled

    def losses(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """Denoising score matching, weighted by sigma^2."""
        freeze_batchnorm(self.net, self.epoch >= self.options.freeze_epochs)
        points, neighbours, target = self.clouds.rows(self._batch())
        self._generator.manual_seed(self.options.seed + 1_000_003 * (self.step + 1))
        noised = PROCESS.noised(target, self.options.draws, self._generator)
        predicted = self.module(points, neighbours, noised.u, noised.t)
        return {"loss": (predicted - noised.goal).square().sum(-1).mean()}, {}

    def reseed(self) -> None:
        """Nothing: all random numbers depend on the step."""

    def write(self) -> None:
        """Write the averaged weights, judged on the clouds kept aside."""
        net = self.export()
        estimator = PaperEstimator(net, self.column, str(self.distributed.device))
        table: dict[str, Any] = {}
        with contextlib.suppress(TooleeError):  # RK45 does not solve the field of every network that has only begun
            table = validation.metrics(validation.evaluate(estimator, self._judged, PaperEstimator.candidates))
        self.record({"event": "validation", "epoch": self.epoch, **table})
        report: dict[str, Any] = {
            "steps": self.step,
            "epochs": self.step / self.steps_per_epoch,
            "clouds": len(self.clouds),
        }
        report |= {"minutes": round(self.elapsed / 60, 2), "validation": table, "train": asdict(self.options)}
        save(self.out, net, self.column, report)

    def export(self) -> PaperNet:
        """The averaged network, rounded to half precision as it will be stored."""
        return with_weights(self.net, self.averaged())

    def _batch(self) -> Tensor:
        """Numbers of the next step's clouds."""
        if self._order is None or self._order[0] != self.epoch:
            shuffler = torch.Generator().manual_seed(self.options.seed + 7919 * (self.epoch + 1))
            order = torch.randperm(len(self.clouds), generator=shuffler)
            self._order = self.epoch, order.to(self.distributed.device)
        first = self.step % self.steps_per_epoch * self.options.batch
        return self._order[1][first : first + self.options.batch]


def freeze_batchnorm(net: nn.Module, frozen: bool) -> None:
    """Switch batch normalisation between running statistics, kept, and its batch's; its weights learn either way.

    In training a layer subtracts its batch's mean, which varies between batches: of B clouds that lie s apart, by s /
    sqrt(B). Where clouds are not centred this hides the tool's place in the camera frame by that much (128 clouds over
    17 cm of depth: 15 mm). Fixed statistics avoid it, and a step takes two thirds of the time.

    Args:
        net: The network.
        frozen: Whether the running statistics are used and kept.
    """
    for module in net.modules():
        if isinstance(module, nn.BatchNorm1d):
            module.train(not frozen)


def paper_source(clouds: RenderedClouds, column: Column, device: torch.device | str, seed: int) -> RenderedSource:
    """Stored clouds as the paper's network takes them.

    Args:
        clouds: The clouds.
        column: Column of the paper's table.
        device: torch device.
        seed: Seed of the order of the points.

    Returns:
        The source.
    """
    config = CloudConfig(
        negative_share=0.0,
        radius=OBJECT_RADIUS if column.of_tool else None,
        points=POINTS,
        ordered=ORDERED,
        rest=False,
        guessed=False,
    )
    return RenderedSource(clouds, device, seed, config)


def category_priors(clouds: RenderedClouds) -> Array:
    """Mean X_tool_ee of each category over the clouds, modulo its group.

    Returns:
        (4, 4, 4); the identity where there are none.
    """
    priors = np.tile(np.eye(4), (len(Category), 1, 1))
    for i, category in enumerate(Category):
        rows = clouds.positive & (clouds.category == i)
        if rows.any():
            X_tool_ee = inverse(clouds.X_camera_tool[rows].astype(np.float64)) @ clouds.X_camera_ee[rows]
            priors[i] = mean_pose(X_tool_ee, category.symmetry)
    return priors


def train_column(
    out: Path, options: PaperOptions, column: str, files: Sequence[Path], init: Path | None = None
) -> dict[str, Any]:
    """Train a column of the paper's Table I.

    Args:
        out: Folder for checkpoint, weights and log.
        options: Options of the training.
        column: Name of the column.
        files: Files of `RenderedClouds` under true masks.
        init: Folder of weights of the same column to start from.

    Returns:
        Steps and epochs so far.

    Raises:
        AssetError: Clouds are missing.
        UserError: They are of the other kind, or too few; there is no such column, or the weights are of another.
        TooleeError: The loss is not finite.
    """
    if column not in COLUMNS:
        raise UserError(f"--column {column}: choose one of {', '.join(COLUMNS)}")
    clouds = RenderedClouds.cat([RenderedClouds.load(path) for path in files])
    clouds.check_kind(COLUMNS[column].of_tool)
    if not clouds.positive.all():
        raise UserError(
            "some clouds are a detector's, of other things: make them with `toolee train clouds --true-masks`"
        )
    with init_distributed(options.device) as distributed:
        training = ColumnTraining(out, options, COLUMNS[column], clouds, distributed)
        if init is not None:
            training.start_from(init)
        training.loop()
        return {"steps": training.step, "epochs": round(training.step / training.steps_per_epoch, 2)}
