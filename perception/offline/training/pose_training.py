"""Training of the pose network on synthetic clouds, of which a buffer is replayed: `toolee train pose`."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from toolee_robot.errors import AssetError, UserError
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch, CloudConfig, CloudSource, Mixture
from toolee_robot.perception.offline.synthetic_clouds.generator import CloudGenerator
from toolee_robot.perception.offline.synthetic_clouds.rendered import RenderedClouds, RenderedSource
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import (
    Float32,
    SurfaceSamples,
    sample_hands,
    sample_tools,
)
from toolee_robot.perception.offline.training import pose_validation as validation
from toolee_robot.perception.offline.training.loop import Distributed, TrainingRun, init_distributed, with_weights
from toolee_robot.perception.offline.training.options import TrainingOptions
from toolee_robot.perception.offline.training.pose_losses import augment, pose_loss, without_rest
from toolee_robot.perception.pose import weights
from toolee_robot.perception.pose.estimator import PoseEstimator
from toolee_robot.perception.pose.network import NetworkConfig, PoseNet
from toolee_robot.perception.pose.weights import Calibration


@dataclass(frozen=True, kw_only=True)
class TrainConfig(TrainingOptions):
    """The options of a training of the pose network.

    Attributes:
        batch: Clouds per step and rank.
        warmup_steps: See `TrainingOptions`, as the next two.
        weight_decay: Weight decay of AdamW.
        clip_norm: Largest norm of the gradient.
        reuse: How often a cloud is shown.
        chunk: Clouds generated at a time.
        capacity: Clouds in the replay buffer.
        first_fill: Clouds generated before the first step.
        train_seeds: Training tools of each kind.
        test_seeds: Held-out tools of each kind.
        validation: Held-out clouds.
        rendered_share: Share of rendered clouds, where some are given.
        init_share: Share of the initial weights in the final ones, where the training starts from weights (Wortsman et
            al., "Robust fine-tuning of zero-shot models", CVPR 2022).

    """

    USUAL_MINUTES: ClassVar[float] = 9.0
    """Default budget [min]."""

    batch: int = 512
    warmup_steps: int = 300
    weight_decay: float = 1e-4
    clip_norm: float = 1.0
    reuse: float = 4.0
    chunk: int = 2048
    capacity: int = 65_536
    first_fill: int = 8192
    train_seeds: int = 480
    test_seeds: int = 30
    validation: int = 4096
    rendered_share: float = 0.5
    init_share: float = 0.0


DRAWS = 8
"""Noise draws per encoded cloud."""
_NO_REST, _NO_DIRECTION = 0.35, 0.5
"""Shares of the clouds that are shown without the rest of the tool, and of these without the direction to it."""


class Trainer(TrainingRun):
    """The training of one network within one budget, on one device or, as one of several processes, on several.

    `run` may be called again in a new process: it resumes. The first rank validates, logs and writes.

    Args:
        out: Folder for checkpoint, weights and log.
        config: Options of the training.
        samples: Surface samples of training and of held-out tools.
        hands: Surface samples of hands.
        distributed: This process among those that train together.
        rendered: Stored clouds to mix in.
        network: Architecture; None: the default.
    """

    name = weights.NAME
    log_seconds = 15.0
    averages_buffers = False

    def __init__(
        self,
        out: Path,
        config: TrainConfig,
        samples: tuple[SurfaceSamples, SurfaceSamples],
        hands: Float32,
        distributed: Distributed,
        rendered: RenderedClouds | None = None,
        network: NetworkConfig | None = None,
    ) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.net = PoseNet(network).to(distributed.device)
        super().__init__(config, out, distributed, self.net, self.net)
        self.start_share = config.init_share
        self._generator: CloudSource = CloudGenerator(samples[0], hands, distributed.device, self._seed(1))
        self._rendered = 0 if rendered is None else len(rendered)
        if rendered is not None:
            kept = RenderedSource(rendered, distributed.device, self._seed(3), CloudConfig())
            self._generator = Mixture(self._generator, kept, config.rendered_share)
        self._test_samples = samples[1]
        self._clouds_held_out = CloudGenerator(samples[1], hands, distributed.device, 10_000 + config.seed)
        self._held_out: CloudBatch | None = None
        self._g = torch.Generator(distributed.device).manual_seed(self._seed(2))

    def run(self) -> dict[str, Any]:
        """Train until the budget is used up, then validate, calibrate and write the weights.

        Returns:
            The report; empty for ranks other than the first.
        """
        self.loop()
        return {} if self._held_out is None else self.finish(self._held_out)

    def make_optimizer(self) -> torch.optim.Optimizer:
        """AdamW with the same decay for all parameters."""
        c, fused = self.config, self.distributed.device.type == "cuda"
        parameters = self.net.parameters()
        return torch.optim.AdamW(parameters, c.lr, weight_decay=c.weight_decay, betas=(0.9, 0.99), fused=fused)

    def schedule(self, progress: float) -> float:
        """Cosine decay to a thousandth; see `TrainingRun`."""
        return max(0.5 * (1 + math.cos(math.pi * min(progress, 1.0))), 1e-3)

    def prepare(self) -> nn.Module:
        """Generate the first clouds, and compile the network on a GPU."""
        c = self.config
        network = self._compiled() if c.compile and self.distributed.device.type == "cuda" else self.net
        self._reservoir = ReplayBuffer(self._generator.collect(max(c.first_fill, c.batch), c.chunk), c.capacity)
        self._first_clouds, self._first_step = self._reservoir.made, self.step
        self._held_out = self.judged() if self.distributed.first else None
        return network

    def losses(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """The loss on an augmented batch; new clouds are generated so that each is shown `reuse` times."""
        c = self.config
        shown = (self.step - self._first_step) * c.batch
        while self._reservoir.made - self._first_clouds < shown / c.reuse:
            self._reservoir.add(self._generator.generate(c.chunk))
        batch = without_rest(self._reservoir.draw(c.batch, self._g), _NO_REST, _NO_DIRECTION, self._g)
        loss, parts = self._loss(self.module, augment(batch, self._g))
        return {"loss": loss}, parts

    def grow(self) -> dict[str, float]:
        """Nothing to add: `losses` generates the clouds. Returns their number for the log."""
        return {"clouds": self._reservoir.made}

    def reseed(self) -> None:
        """Seed clouds and batches anew after a resumption."""
        self._generator.reseed(self._seed(1))
        self._g.manual_seed(self._seed(2))

    def start_from(self, folder: Path) -> None:
        """Start from the network in a folder.

        Args:
            folder: The folder.

        Raises:
            AssetError: The network has another architecture, or cannot be read.
        """
        state = weights.load(folder)[0].state_dict()
        try:
            self.net.load_state_dict(state)
        except RuntimeError as error:
            raise AssetError(
                f"{folder} holds a network of another architecture: {error}", code="asset.architecture"
            ) from error
        self._take_average(state)
        self.start = {name: value.clone() for name, value in self.average.items()}  # the average changes in place
        self.record({"event": "begun from other weights"})

    def finish(self, held_out: CloudBatch) -> dict[str, Any]:
        """Validate and calibrate on held-out clouds, and write the weights.

        Args:
            held_out: The clouds.

        Returns:
            The report.
        """
        report, calibration = judge(self.export(), held_out, self._test_samples, str(self.distributed.device))
        self.record({"event": "finished", **{k: v for k, v in report.items() if k != "clouds"}})
        report |= self._described(calibrated=True)
        weights.save(self.out, self.export(), calibration, report)
        return report

    def judged(self) -> CloudBatch:
        """The next held-out clouds."""
        return self._clouds_held_out.collect(self.config.validation, self.config.chunk)

    def export(self) -> PoseNet:
        """The averaged network, rounded to half precision, as it will be stored."""
        return with_weights(self.net, self.averaged())

    def write(self) -> None:
        """Write the weights without calibration; validated while there is more to train."""
        weights.save(self.out, self.export(), Calibration(), self._described(calibrated=False))
        if self._held_out is not None and self.progress < 1:
            few = self._held_out.select(torch.arange(min(512, len(self._held_out)), device=self.distributed.device))
            estimator = PoseEstimator(self.export(), Calibration(), str(self.distributed.device))
            self.record({"event": "validation", **validation.metrics(validation.evaluate(estimator, few, 20))})

    def _described(self, calibrated: bool) -> dict[str, Any]:
        """Description of the training, stored beside the weights."""
        train = {**asdict(self.config), "rendered_clouds": self._rendered}
        minutes = round(self.elapsed / 60, 2)
        return {"calibrated": calibrated, "steps": self.step, "minutes": minutes, "train": train}

    def _take_average(self, state: dict[str, Tensor]) -> None:
        self.average = {name: value.to(self.distributed.device, copy=True) for name, value in state.items()}

    def _compiled(self) -> nn.Module:
        """The network compiled, or unchanged where the compiler fails."""
        compiled: nn.Module = torch.compile(self.net)  # type: ignore[assignment]
        batch = self._generator.collect(self.config.batch, self.config.chunk)
        try:
            self._loss(compiled, batch)[0].backward()  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001 - the compiler's errors have no common root; eager always works
            self.record({"event": "not compiled", "error": f"{type(error).__name__}: {error}"[:300]})
            torch._dynamo.reset()
            compiled = self.net
        self.net.zero_grad(set_to_none=True)
        return compiled

    def _loss(self, network: nn.Module, batch: CloudBatch) -> tuple[Tensor, dict[str, Tensor]]:
        return pose_loss(network, batch, DRAWS, self._g, PoseNet.process)

    def _seed(self, which: int) -> int:
        """Seed that differs between ranks, and after a resumption."""
        return self.config.seed + which + 1_000_003 * self.distributed.rank + self.step


def judge(
    net: PoseNet, held_out: CloudBatch, samples: SurfaceSamples, device: str
) -> tuple[dict[str, Any], Calibration]:
    """Metrics on held-out clouds, and the calibration: fitted on half of the tools, reported on the others."""
    estimator = PoseEstimator(net, Calibration(), device)
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
    report["clouds"] = asdict(CloudConfig())
    return report, calibration


def _half(
    batch: CloudBatch, samples: SurfaceSamples, evaluated: validation.Evaluated, parity: int
) -> validation.Evaluated:
    """The clouds of every second tool; by tool, so that a hammer's claw and head stay together."""
    chosen = np.flatnonzero(samples.tools[evaluated.item] % 2 == parity)
    index = torch.as_tensor(chosen, device=batch.points.device)
    return validation.Evaluated(batch.select(index), [evaluated.results[i] for i in chosen])


def train(
    out: Path,
    config: TrainConfig,
    init: Path | None = None,
    rendered: Sequence[Path] = (),
) -> dict[str, Any]:
    """Train a pose network: surface samples, training, validation, calibration.

    Args:
        out: Folder for checkpoint, weights and log.
        config: Options of the training.
        init: Folder of weights of the same architecture to start from; their process may differ.
        rendered: Files of `RenderedClouds` to mix in.

    Returns:
        The report; empty for ranks other than the first.

    Raises:
        AssetError: Weights or clouds are missing or do not fit.
        UserError: Options contradict each other.
        TooleeError: The loss is not finite.
    """
    if config.init_share and init is None:
        raise UserError("init_share: say whose share that is, with --init FOLDER", code="user.init_share")
    kept = None
    if rendered:
        kept = RenderedClouds.cat([RenderedClouds.load(path) for path in rendered])
        kept.check_kind(of_tool=False)  # before the long sampling
    begun = time.monotonic()
    samples = sample_tools(False, config.train_seeds), sample_tools(True, config.test_seeds)
    hands = sample_hands()
    print(
        f"{[len(b.category) for b in samples]} EEs and {len(hands)} hands sampled in {time.monotonic() - begun:.0f} s"
    )
    with init_distributed(config.device) as distributed:
        trainer = Trainer(out, config, samples, hands, distributed, kept)
        if init is not None:
            trainer.start_from(init)
        return trainer.run()


class ReplayBuffer:
    """A ring buffer of clouds on the device: new ones replace the oldest, batches are drawn at random.

    Args:
        first: The first clouds.
        capacity: Number of clouds that it holds.

    Attributes:
        made: Number of clouds added so far.
    """

    def __init__(self, first: CloudBatch, capacity: int) -> None:
        self._rows = {
            f.name: torch.empty(
                (capacity, *getattr(first, f.name).shape[1:]),
                dtype=getattr(first, f.name).dtype,
                device=first.points.device,
            )
            for f in fields(CloudBatch)
        }
        self._capacity, self._filled, self._next = capacity, 0, 0
        self.made = 0
        self.add(first)

    def add(self, batch: CloudBatch) -> None:
        """Add clouds in place of the oldest ones."""
        device = batch.points.device
        index = (self._next + torch.arange(len(batch), device=device)) % self._capacity
        for name, rows in self._rows.items():
            rows[index] = getattr(batch, name)
        self._next = (self._next + len(batch)) % self._capacity
        self._filled = min(self._filled + len(batch), self._capacity)
        self.made += len(batch)

    def draw(self, n: int, generator: torch.Generator) -> CloudBatch:
        """Draw clouds at random, with replacement.

        Args:
            n: How many.
            generator: Random generator, on the buffer's device.

        Returns:
            The clouds.
        """
        index = torch.randint(self._filled, (n,), device=generator.device, generator=generator)
        return CloudBatch(**{name: rows[index] for name, rows in self._rows.items()})
