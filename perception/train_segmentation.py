"""Train the detector from scratch within a budget of minutes, on one GPU, several, or (small) on a CPU.

    python -m toolee_robot.perception.train_segmentation --data data/train --out runs/segmentation --minutes 12
    torchrun --nproc-per-node 4 -m toolee_robot.perception.train_segmentation --data data/train --out runs/seg

The whole data set is held on the device as bytes (each rank its share); scenes that appear while it trains are taken
in, so generation may still run. Targets and augmentation are made on the device. The learning rate follows the clock:
a run ends annealed whatever the machine's speed. A run that is interrupted continues from its last checkpoint with
`--resume`; `--init DIR` starts from the weights that another run exported. Every checkpoint, and the last act, writes
the averaged weights in half precision.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.perception.assets import load_weights, save_weights
from toolee_robot.perception.ranks import Ranks
from toolee_robot.perception.ranks import ranks as ranks_of
from toolee_robot.perception.segmentation_data import DeviceImages, SceneStream, SegmentationImages, augment
from toolee_robot.perception.segmentation_losses import DetectorLoss, instances_from_maps
from toolee_robot.perception.segmentation_model import (
    CLASSES,
    WEIGHTS_NAME,
    Detector,
    DetectorConfig,
    load_detector,
    working_size,
)
from toolee_robot.perception.training_log import Scalars

CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True)
class SegmentationTraining:
    """A training run. minutes: wall-clock budget of the optimisation, loading excluded. batch: images a rank.
    patience [s]: how long to wait for the first scene of a data set that is still being generated."""

    data: Path
    out: Path
    minutes: float = 12.0
    batch: int = 32
    lr: float = 1e-3
    weight_decay: float = 0.05
    warmup_steps: int = 200
    clip_norm: float = 10.0
    ema: float = 0.999
    augmentation: float = 1.0
    seed: int = 0
    max_steps: int | None = None
    checkpoint_minutes: float = 2.0
    log_every: int = 20
    patience: float = 120.0
    resume: bool = False
    init: Path | None = None
    device: str = "auto"
    compile: bool = True
    model: DetectorConfig = field(default_factory=DetectorConfig)

    def __post_init__(self) -> None:
        if not (self.minutes > 0 and self.batch > 0 and self.lr > 0 and 0 < self.ema < 1):
            raise UserError("minutes, batch and lr must be positive, ema between 0 and 1")

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "data": self.data.name, "out": self.out.name, "init": self.init is not None}


def train(config: SegmentationTraining, images: SegmentationImages | None = None) -> Path:
    """Run the training and return the folder with the exported weights, their configuration and log.

    images: the data, if not to be read from `config.data`. Raises TooleeError when a loss is not finite.
    """
    with ranks_of(None if config.device == "auto" else config.device) as ranks:
        torch.manual_seed(config.seed + 1000 * ranks.rank)
        torch.backends.cudnn.benchmark = True
        stream = SceneStream(config.data, (ranks.rank, ranks.world)) if images is None else None
        try:
            first = [images] if images is not None else stream.take(config.patience) if stream else []
            if not first:
                raise UserError(f"{config.data} holds no scene for rank {ranks.rank}: generate the data set first")
            run = _Run(config, ranks, first, stream)
            run.loop()
            if ranks.first:
                run.export()
        finally:
            if stream is not None:
                stream.close()
    return config.out


class _Run:
    """The state of one run: network, average, optimiser, clock and log."""

    def __init__(
        self,
        config: SegmentationTraining,
        ranks: Ranks,
        first: list[SegmentationImages],
        stream: SceneStream | None,
    ) -> None:
        self.config, self.ranks, self.stream = config, ranks, stream
        self.data = DeviceImages(first[0], ranks.device)
        self._grow(first[1:])
        detector = Detector(config.model)
        if config.init is not None:
            load_detector(detector, *load_weights(config.init, WEIGHTS_NAME))
        detector = detector.to(ranks.device).to(memory_format=torch.channels_last)
        self.loss = DetectorLoss(detector)
        self.augment = augment
        if config.compile and ranks.device.type == "cuda":
            # 747 images a second on each of two GPUs; 667 on one without. Targets stay as they are: compiled, argmax
            # took the last of equal values instead of the first, and a training learnt from wrong boxes.
            detector.backbone.compile(dynamic=False)
            self.loss.compile_proposal_losses()
            self.augment = torch.compile(augment, dynamic=False)
        self.average = {k: v.detach().clone().float() for k, v in detector.state_dict().items()}
        decayed = [p for p in detector.parameters() if p.ndim > 1]
        plain = [p for p in detector.parameters() if p.ndim <= 1]
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
        self.module = ranks.shared(self.loss)

    @property
    def detector(self) -> Detector:
        return self.loss.detector

    def loop(self) -> None:
        config, ranks = self.config, self.ranks
        if ranks.first:
            config.out.mkdir(parents=True, exist_ok=True)
            size = sum(p.numel() for p in self.detector.parameters()) / 1e6
            print(f"segmentation: {size:.2f} M parameters, {len(self.data)} images a rank, {ranks.device_name}")
        self.module.train()
        began = time.monotonic() - self.elapsed
        last_checkpoint, last_log, last_step = self.elapsed, self.elapsed, self.step
        progress = self._progress()
        while progress < 1.0:
            for group in self.optimizer.param_groups:
                group["lr"] = config.lr * self._schedule(progress)
            losses, norm = self._optimise()
            self.step += 1
            if self.step % config.log_every == 0 or self.step == config.max_steps:
                self.elapsed = ranks.agreed(time.monotonic() - began)
                progress = self._progress()
                values = {name: float(value) for name, value in losses.items()} | {"gradient_norm": float(norm)}
                self._stop_unless_finite(values)
                rate = (self.step - last_step) * config.batch * ranks.world / max(self.elapsed - last_log, 1e-9)
                last_log, last_step = self.elapsed, self.step
                self._grow(self.stream.take() if self.stream is not None else [])
                pace = {"images_per_second": rate, "images": len(self.data) * ranks.world}
                self._record({"step": self.step, "minutes": self.elapsed / 60, **pace, **values})
                if self.elapsed - last_checkpoint > 60 * config.checkpoint_minutes:
                    last_checkpoint = self.elapsed
                    self._checkpoint()
            elif config.max_steps is not None:
                progress = self._progress()
        self._checkpoint()

    def _grow(self, images: list[SegmentationImages]) -> None:
        for more in images:
            self.data.extend(more)

    def export(self) -> None:
        """Averaged weights as safetensors, configuration and log as JSON, into `config.out`."""
        description = {
            "kind": "mask_rcnn_resnet18_fpn",
            "classes": list(CLASSES),
            "model": self.config.model.to_json(),
            "training": self.config.to_json(),
            "steps": self.step,
            "minutes": self.elapsed / 60,
            "device": self.ranks.device_name,
            "torch": torch.__version__,
            "log": _thinned(self.log),
        }
        tensors = {k: v for k, v in self.average.items() if not k.endswith("num_batches_tracked")}
        save_weights(self.config.out, WEIGHTS_NAME, tensors, description)
        print(f"segmentation: wrote {self.config.out / WEIGHTS_NAME}*.safetensors after {self.step} steps")

    def _optimise(self) -> tuple[dict[str, Tensor], Tensor]:
        config, device = self.config, self.ranks.device
        sample = self.data.sample(config.batch)
        size = working_size(sample.rgb.shape[1], sample.rgb.shape[2], config.model.working_pixels)
        batch, maps = self.augment(sample, size, config.augmentation)
        instances = instances_from_maps(maps, sample.categories, self.data.tools)
        pixels = batch.pixels.contiguous(memory_format=torch.channels_last)
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            losses: dict[str, Tensor] = self.module(replace(batch, pixels=pixels), instances)
        total = sum(losses.values(), torch.zeros((), device=device))
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(total)
        norm = nn.utils.clip_grad_norm_(self.detector.parameters(), config.clip_norm)
        self.optimizer.step()
        self._update_average()
        return {"loss": total.detach(), **{k: v.detach() for k, v in losses.items()}}, norm

    @torch.no_grad()
    def _update_average(self) -> None:
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        state = self.detector.state_dict()
        averaged = [k for k in self.average if state[k].is_floating_point()]
        torch._foreach_lerp_([self.average[k] for k in averaged], [state[k].float() for k in averaged], 1 - decay)

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
                f"{self.checkpoint_path}; lower --lr or --clip-norm and use --resume"
            )

    def _record(self, entry: dict[str, float]) -> None:
        self.log.append(entry)
        if self.ranks.first:
            self.scalars.add(self.step, entry)
            print(" ".join(f"{k} {v:.4g}" for k, v in entry.items()), flush=True)
            (self.config.out / "training_log.json").write_text(json.dumps(self.log))

    def _checkpoint(self) -> None:
        if not self.ranks.first:
            return
        state = {
            "model": self.detector.state_dict(),
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
        state = torch.load(self.checkpoint_path, map_location=self.ranks.device, weights_only=True)
        self.detector.load_state_dict(state["model"])
        self.average = state["average"]
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.elapsed, self.log = state["step"], state["elapsed"], state["log"]
        # Other images, other augmentation than the first process began with.
        torch.manual_seed(self.config.seed + 1000 * self.ranks.rank + 1_000_003 * self.step)


def _thinned(log: list[dict[str, float]], count: int = 200) -> list[dict[str, float]]:
    step = max(1, len(log) // count)
    return log[::step]


def _parse() -> SegmentationTraining:
    """The command line, with argparse: a GPU machine needs torch and safetensors for this file and no more."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--data", type=Path, required=True, help="data set, as `toolee_robot.perception.dataset` writes it"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for checkpoints, log and weights")
    parser.add_argument("--minutes", type=float, default=SegmentationTraining.minutes)
    parser.add_argument("--batch", type=int, default=SegmentationTraining.batch, help="images a rank")
    parser.add_argument("--lr", type=float, default=SegmentationTraining.lr)
    parser.add_argument("--clip-norm", type=float, default=SegmentationTraining.clip_norm)
    parser.add_argument("--ema", type=float, default=SegmentationTraining.ema)
    parser.add_argument("--checkpoint-minutes", type=float, default=SegmentationTraining.checkpoint_minutes)
    parser.add_argument("--max-steps", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--resume", action="store_true", help="continue from the checkpoint in --out")
    parser.add_argument("--init", type=Path, help="folder of exported weights to start from")
    return SegmentationTraining(**vars(parser.parse_args()))


if __name__ == "__main__":
    train(_parse())
