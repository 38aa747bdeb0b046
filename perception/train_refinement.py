"""Train the refiner of the detector's masks, on one GPU, several, or (for a look) on a CPU.

    python -m toolee_robot.perception.train_refinement --data data/train --out runs/refinement --minutes 15
    torchrun --nproc-per-node 2 -m toolee_robot.perception.train_refinement --data data/train --out runs/refinement

The detector looks once at every image; what it finds is what the refiner learns to draw and to judge. So take images
that the detector was not trained on, or its masks there are better than they will ever be again. Scenes that appear
while it trains are taken in, so generation may still run. The learning rate follows the clock. A run that is
interrupted continues from its last checkpoint with `--resume`. Every checkpoint, and the last act, writes the averaged
weights in half precision.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.perception.assets import load_weights, save_weights
from toolee_robot.perception.ranks import Ranks
from toolee_robot.perception.ranks import ranks as ranks_of
from toolee_robot.perception.refinement_data import Examples, RefinementData
from toolee_robot.perception.segmentation_data import SceneStream
from toolee_robot.perception.segmentation_model import WEIGHTS_NAME as DETECTOR
from toolee_robot.perception.segmentation_model import Detector, DetectorConfig, load_detector
from toolee_robot.perception.segmentation_refiner import WEIGHTS_NAME, Refiner, RefinerConfig, load_refiner
from toolee_robot.perception.training_log import Scalars

CHECKPOINT = "refinement_checkpoint.pt"
_VALIDATED = 2048
_AT_ONCE = 256


@dataclass(frozen=True)
class RefinementTraining:
    """A training run. data: folder of a split. minutes: wall-clock budget, from the first scene on. batch: detections a
    rank. detector: folder of its weights, the shipped ones if None; init: of a refiner's to start from. patience [s]:
    how long to wait for the first scene of a data set that is still being generated."""

    data: Path
    out: Path
    minutes: float = 15.0
    batch: int = 512
    lr: float = 2e-3
    weight_decay: float = 0.05
    warmup_steps: int = 300
    clip_norm: float = 5.0
    ema: float = 0.999
    seed: int = 0
    max_steps: int | None = None
    checkpoint_minutes: float = 2.0
    log_every: int = 50
    patience: float = 120.0
    resume: bool = False
    detector: Path | None = None
    init: Path | None = None
    device: str = "auto"
    compile: bool = True
    model: RefinerConfig = field(default_factory=RefinerConfig)

    def __post_init__(self) -> None:
        if not (self.minutes > 0 and self.batch > 1 and self.lr > 0 and 0 < self.ema < 1):
            raise UserError("minutes, batch and lr must be positive, ema between 0 and 1")

    def to_json(self) -> dict[str, Any]:
        given = {name: getattr(self, name) is not None for name in ("detector", "init")}
        return {**asdict(self), "data": self.data.name, "out": self.out.name, **given}


def losses(logits: Tensor, quality: Tensor, examples: Examples) -> dict[str, Tensor]:
    """Of logits (N, CELLS, CELLS), quality (N,): cross entropy and Dice of the masks that are to be learnt, and cross
    entropy of the IoU that the network expects of every mask with its own, 0 for a false alarm; `iou`: the
    mean of what the former have, `iou_before`: of the detector's."""
    truth, drawn = examples.truth.float(), examples.drawn.float()
    bce = F.binary_cross_entropy_with_logits(logits, truth, reduction="none").mean((1, 2))
    p = logits.sigmoid()
    dice = 1 - (2 * (p * truth).sum((1, 2)) + 1) / (p.sum((1, 2)) + truth.sum((1, 2)) + 1)
    with torch.no_grad():
        iou = _iou(logits > 0, examples.truth) * drawn
        before = _iou(examples.squares[:, -1] > 0, examples.truth)
    expected = F.binary_cross_entropy_with_logits(quality, iou, reduction="none")
    return {
        "mask": _mean(bce, drawn),
        "dice": _mean(0.5 * dice, drawn),
        "quality": _mean(0.3 * expected, examples.counts),
        "iou": _mean(iou, drawn),
        "iou_before": _mean(before, drawn),
    }


def train(config: RefinementTraining) -> Path:
    """Run the training and return the folder with the exported weights, their configuration and log.

    Raises AssetError for missing or broken data or weights, UserError for bad settings, TooleeError when the loss stops
    being finite (the last checkpoint is kept).
    """
    with ranks_of(None if config.device == "auto" else config.device) as ranks:
        torch.manual_seed(config.seed + 1000 * ranks.rank)
        stream = SceneStream(config.data, (ranks.rank, ranks.world))
        try:
            run = _Run(config, ranks, stream)
            run.loop()
            if ranks.first:
                run.export()
        finally:
            stream.close()
    return config.out


class _Run:
    """The state of one run: network, average, optimiser, clock and log."""

    def __init__(self, config: RefinementTraining, ranks: Ranks, stream: SceneStream) -> None:
        self.config, self.ranks, self.stream = config, ranks, stream
        self.device = ranks.device
        tensors, description = load_weights(config.detector, DETECTOR)
        try:
            detector = Detector(DetectorConfig.from_json(description["model"]))
        except (KeyError, TypeError, ValueError) as error:
            raise AssetError(f"the detector's description is damaged, fetch it again: {error!r}") from error
        load_detector(detector, tensors, description)
        self.data = RefinementData(detector, self.device)
        waited = time.monotonic()
        while not self.data.ready and time.monotonic() - waited < config.patience:
            self._grow(1.0)
        if not self.data.ready:
            raise UserError(f"{config.data} shows rank {ranks.rank} no end effector: generate the data set first")
        refiner = Refiner(config.model)
        if config.init is not None:
            load_refiner(refiner, load_weights(config.init, WEIGHTS_NAME)[0])
        self.refiner = refiner.to(self.device).to(memory_format=torch.channels_last)
        if config.compile and self.device.type == "cuda":
            self.refiner.compile(dynamic=False)
        self.average = {k: v.detach().clone().float() for k, v in self.refiner.state_dict().items()}
        decayed = [p for p in self.refiner.parameters() if p.ndim > 1]
        plain = [p for p in self.refiner.parameters() if p.ndim <= 1]
        self.optimizer = torch.optim.AdamW(
            [{"params": decayed, "weight_decay": config.weight_decay}, {"params": plain, "weight_decay": 0.0}],
            lr=config.lr,
        )
        self.step, self.elapsed = 0, 0.0
        self.log: list[dict[str, float]] = []
        self.scalars = Scalars(config.out)
        self.checkpoint_path = config.out / CHECKPOINT
        if config.resume:
            self._restore()
        self.module = ranks.shared(self.refiner)

    def _grow(self, timeout: float = 0.0) -> None:
        for images in self.stream.take(timeout):
            self.data.extend(images)

    def loop(self) -> None:
        config = self.config
        ranks = self.ranks
        if ranks.first:
            config.out.mkdir(parents=True, exist_ok=True)
            size = sum(p.numel() for p in self.refiner.parameters()) / 1e6
            print(
                f"refinement: {size:.2f} M parameters, {len(self.data)} images a rank, {ranks.device_name}", flush=True
            )
        self.module.train()
        began = time.monotonic() - self.elapsed
        last_checkpoint, last_log, last_step = self.elapsed, self.elapsed, self.step
        progress = self._progress()
        while progress < 1.0:
            for group in self.optimizer.param_groups:
                group["lr"] = config.lr * self._schedule(progress)
            values, norm = self._optimise()
            self.step += 1
            if self.step % config.log_every == 0 or self.step == config.max_steps:
                self.elapsed = ranks.agreed(time.monotonic() - began)
                progress = self._progress()
                entry = {name: float(value) for name, value in values.items()} | {"gradient_norm": float(norm)}
                self._stop_unless_finite(entry)
                rate = (self.step - last_step) * config.batch * ranks.world / max(self.elapsed - last_log, 1e-9)
                last_log, last_step = self.elapsed, self.step
                self._grow()
                pace = {"examples_per_second": rate, "images": len(self.data) * ranks.world}
                self._record({"step": self.step, "minutes": self.elapsed / 60, **pace, **entry})
                if self.elapsed - last_checkpoint > 60 * config.checkpoint_minutes:
                    last_checkpoint = self.elapsed
                    self._checkpoint()
            elif config.max_steps is not None:
                progress = self._progress()
        self._checkpoint()

    def _optimise(self) -> tuple[dict[str, Tensor], Tensor]:
        examples = self.data.batch(self.config.batch)
        values = losses(*self._forward(self.module, examples), examples)
        total = values["mask"] + values["dice"] + values["quality"]
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(total)
        norm = nn.utils.clip_grad_norm_(self.refiner.parameters(), self.config.clip_norm)
        self.optimizer.step()
        self._update_average()
        return {"loss": total.detach(), **{k: v.detach() for k, v in values.items()}}, norm

    def _forward(self, refiner: nn.Module, examples: Examples) -> tuple[Tensor, Tensor]:
        squares = examples.squares.contiguous(memory_format=torch.channels_last)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.device.type == "cuda"):
            logits, quality = refiner(squares, examples.category, examples.score)
        return logits.float(), quality.float()

    @torch.no_grad()
    def _update_average(self) -> None:
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        state = self.refiner.state_dict()
        averaged = [k for k in self.average if state[k].is_floating_point()]
        torch._foreach_lerp_([self.average[k] for k in averaged], [state[k].float() for k in averaged], 1 - decay)

    def _averaged(self) -> dict[str, Tensor]:
        return {k: v for k, v in self.average.items() if not k.endswith("num_batches_tracked")}

    @torch.inference_mode()
    def validate(self) -> dict[str, float]:
        """The averaged network on images kept aside: mean IoU of the masks before and after, and losses. Empty where
        they show nothing."""
        refiner = Refiner(self.config.model).to(self.device).to(memory_format=torch.channels_last)
        load_refiner(refiner, self._averaged())
        refiner.eval()
        sums: dict[str, float] = {}
        chosen = self.data.validation[:_VALIDATED]
        for part in torch.split(chosen, _AT_ONCE) if len(chosen) else ():
            examples = self.data.plain(part)
            for name, value in losses(*self._forward(refiner, examples), examples).items():
                sums[name] = sums.get(name, 0.0) + float(value) * len(part) / len(chosen)
        return sums

    def export(self) -> None:
        """Averaged weights as safetensors, configuration, validation and log as JSON, into `config.out`."""
        validation = self.validate()
        print("refinement: kept aside: " + " ".join(f"{k} {v:.4g}" for k, v in validation.items()), flush=True)
        description = {
            "kind": "mask_refiner",
            "model": self.config.model.to_json(),
            "training": self.config.to_json(),
            "steps": self.step,
            "minutes": self.elapsed / 60,
            "images": len(self.data) * self.ranks.world,
            "device": self.ranks.device_name,
            "torch": torch.__version__,
            "validation": validation,
            "log": self.log[:: max(1, len(self.log) // 200)],
        }
        save_weights(self.config.out, WEIGHTS_NAME, self._averaged(), description)
        print(f"refinement: wrote {self.config.out / WEIGHTS_NAME}*.safetensors after {self.step} steps", flush=True)

    def _progress(self) -> float:
        by_clock = self.elapsed / (60 * self.config.minutes)
        by_steps = self.step / self.config.max_steps if self.config.max_steps else 0.0
        return max(by_clock, by_steps)

    def _schedule(self, progress: float) -> float:
        warm = min(1.0, (self.step + 1) / self.config.warmup_steps)
        return warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(progress, 1.0))))

    def _stop_unless_finite(self, values: dict[str, float]) -> None:
        bad = [name for name, value in values.items() if not math.isfinite(value)]
        if bad:
            raise TooleeError(
                f"training stopped at step {self.step}: {', '.join(bad)} not finite. The last good state is "
                f"{self.checkpoint_path}; lower --lr and use --resume"
            )

    def _record(self, entry: dict[str, float]) -> None:
        self.log.append(entry)
        if not self.ranks.first:
            return
        self.scalars.add(self.step, entry, WEIGHTS_NAME)
        print(" ".join(f"{k} {v:.4g}" for k, v in entry.items()), flush=True)

    def _checkpoint(self) -> None:
        if not self.ranks.first:
            return
        state = {
            "model": self.refiner.state_dict(),
            "average": self.average,
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "elapsed": self.elapsed,
            "log": self.log,
        }
        partial = self.checkpoint_path.with_suffix(".partial")
        torch.save(state, partial)
        partial.replace(self.checkpoint_path)
        self.export()

    def _restore(self) -> None:
        if not self.checkpoint_path.is_file():
            raise UserError(f"nothing to resume: {self.checkpoint_path} does not exist; start without --resume")
        state = torch.load(self.checkpoint_path, map_location=self.device, weights_only=True)
        self.refiner.load_state_dict(state["model"])
        self.average = state["average"]
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.elapsed, self.log = state["step"], state["elapsed"], state["log"]
        torch.manual_seed(self.config.seed + 1000 * self.ranks.rank + 1_000_003 * self.step)


def _iou(a: Tensor, b: Tensor) -> Tensor:
    return (a & b).sum((1, 2)) / (a | b).sum((1, 2)).clamp(min=1)


def _mean(values: Tensor, weights: Tensor) -> Tensor:
    weights = weights.float()
    return (values * weights).sum() / weights.sum().clamp(min=1)


def _parse() -> RefinementTraining:
    """The command line, with argparse: a GPU machine needs torch and safetensors for this file and no more."""
    default = RefinementTraining
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of a split of a data set")
    parser.add_argument("--out", type=Path, required=True, help="folder for checkpoints, log and weights")
    parser.add_argument("--minutes", type=float, default=default.minutes)
    parser.add_argument("--batch", type=int, default=default.batch, help="detections a step")
    parser.add_argument("--lr", type=float, default=default.lr)
    parser.add_argument("--max-steps", type=int)
    parser.add_argument("--checkpoint-minutes", type=float, default=default.checkpoint_minutes)
    parser.add_argument("--log-every", type=int, default=default.log_every)
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--device", default=default.device)
    parser.add_argument("--resume", action="store_true", help="continue from the checkpoint in --out")
    parser.add_argument("--detector", type=Path, help="folder of the detector's weights (default: the shipped ones)")
    parser.add_argument("--init", type=Path, help="folder of exported weights to start from")
    return RefinementTraining(**vars(parser.parse_args()))


if __name__ == "__main__":
    train(_parse())
