"""What the trainings on images share: options, the loop against the clock, the average of the weights, checkpoints."""

from __future__ import annotations

import json
import math
import time
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.files import written_whole
from toolee_robot.perception.assets import save_weights
from toolee_robot.perception.ranks import Ranks
from toolee_robot.perception.training_log import Scalars


@dataclass(frozen=True)
class ImageTraining:
    """A training run. data: a split's folder. minutes: wall-clock budget of the optimisation. batch: of each rank.
    init: folder of exported weights to start from. patience [s]: how long to wait for the first scene of a data set
    that is still being generated."""

    data: Path
    out: Path
    minutes: float = 12.0
    batch: int = 32
    lr: float = 1e-3
    weight_decay: float = 0.05
    warmup_steps: int = 200
    clip_norm: float = 10.0
    ema: float = 0.999
    seed: int = 0
    max_steps: int | None = None
    checkpoint_minutes: float = 2.0
    log_every: int = 20
    patience: float = 120.0
    resume: bool = False
    init: Path | None = None
    device: str = "auto"
    compile: bool = True

    def __post_init__(self) -> None:
        if not (self.minutes > 0 and self.batch > 0 and self.lr > 0 and 0 < self.ema < 1):
            raise UserError("minutes, batch and lr must be positive, ema between 0 and 1")

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "data": self.data.name, "out": self.out.name, "init": self.init is not None}


class TrainingRun(ABC):
    """The state of one run: network, average, optimiser, clock and log.

    name: of the weights; checkpoint, log: names of files in the output folder; unit: what a batch is made of; tag: of
    the curves. `module` is what the ranks share.
    """

    name: str
    checkpoint: str
    log_name: str
    unit: str
    tag: str = "train"

    def __init__(self, config: ImageTraining, ranks: Ranks, network: nn.Module, module: nn.Module) -> None:
        """module: the network, or what holds it and makes its losses. Raises UserError where nothing can be resumed."""
        self.ranks, self.network = ranks, network
        self._c = config
        self.average = {k: v.detach().clone().float() for k, v in network.state_dict().items()}
        decayed = [p for p in network.parameters() if p.ndim > 1]
        plain = [p for p in network.parameters() if p.ndim <= 1]
        self.optimizer = torch.optim.AdamW(
            [{"params": decayed, "weight_decay": config.weight_decay}, {"params": plain, "weight_decay": 0.0}],
            lr=config.lr,
        )
        self.step, self.elapsed = 0, 0.0
        self.log: list[dict[str, float]] = []
        self.scalars = Scalars(config.out)
        self.checkpoint_path = config.out / self.checkpoint
        if config.resume:
            self._restore()
        self.module = ranks.shared(module)

    @abstractmethod
    def losses(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """Of the next batch: the losses, to be added, and what else is to be logged."""

    @abstractmethod
    def images(self) -> int:
        """How many images this rank has."""

    @abstractmethod
    def grow(self) -> None:
        """Take in the images that have come."""

    @abstractmethod
    def described(self) -> dict[str, Any]:
        """What stands beside the weights, but for what every run knows of itself."""

    def loop(self) -> None:
        """Train until the time or the steps are used up. Raises TooleeError when the loss stops being finite."""
        config, ranks = self._c, self.ranks
        if ranks.first:
            config.out.mkdir(parents=True, exist_ok=True)
            size = sum(p.numel() for p in self.network.parameters()) / 1e6
            print(
                f"{self.name}: {size:.2f} M parameters, {self.images()} images a rank, {ranks.device_name}", flush=True
            )
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
                self.grow()
                pace = {f"{self.unit}_per_second": rate, "images": self.images() * ranks.world}
                self._record({"step": self.step, "minutes": self.elapsed / 60, **pace, **values})
                if self.elapsed - last_checkpoint > 60 * config.checkpoint_minutes:
                    last_checkpoint = self.elapsed
                    self._checkpoint()
            elif config.max_steps is not None:
                progress = self._progress()
        self._checkpoint()

    def averaged(self) -> dict[str, Tensor]:
        """The averaged weights, as they are exported."""
        return {k: v for k, v in self.average.items() if not k.endswith("num_batches_tracked")}

    def export(self) -> None:
        """Averaged weights as safetensors, configuration and log as JSON, into the output folder."""
        description = {
            **self.described(),
            "training": self._c.to_json(),
            "steps": self.step,
            "minutes": self.elapsed / 60,
            "images": self.images() * self.ranks.world,
            "device": self.ranks.device_name,
            "torch": torch.__version__,
            "log": self.log[:: max(1, len(self.log) // 200)],
        }
        save_weights(self._c.out, self.name, self.averaged(), description)
        print(f"{self.name}: wrote {self._c.out / self.name}*.safetensors after {self.step} steps", flush=True)

    def _optimise(self) -> tuple[dict[str, Tensor], Tensor]:
        losses, more = self.losses()
        total = sum(losses.values(), torch.zeros((), device=self.ranks.device))
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(total)
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), self._c.clip_norm)
        self.optimizer.step()
        self._update_average()
        return {"loss": total.detach(), **{k: v.detach() for k, v in (losses | more).items()}}, norm

    @torch.no_grad()
    def _update_average(self) -> None:
        decay = min(self._c.ema, (1 + self.step) / (10 + self.step))
        state = self.network.state_dict()
        averaged = [k for k in self.average if state[k].is_floating_point()]
        torch._foreach_lerp_([self.average[k] for k in averaged], [state[k].float() for k in averaged], 1 - decay)

    def _progress(self) -> float:
        by_clock = self.elapsed / (60 * self._c.minutes)
        by_steps = self.step / self._c.max_steps if self._c.max_steps else 0.0
        return max(by_clock, by_steps)

    def _schedule(self, progress: float) -> float:
        warm = min(1.0, (self.step + 1) / self._c.warmup_steps)
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
            self.scalars.add(self.step, entry, self.tag)
            print(" ".join(f"{k} {v:.4g}" for k, v in entry.items()), flush=True)
            (self._c.out / self.log_name).write_text(json.dumps(self.log))

    def _checkpoint(self) -> None:
        if not self.ranks.first:
            return
        state = {
            "model": self.network.state_dict(),
            "average": self.average,
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "elapsed": self.elapsed,
            "log": self.log,
        }
        with written_whole(self.checkpoint_path) as scratch:
            torch.save(state, scratch)
        self.export()

    def _restore(self) -> None:
        if not self.checkpoint_path.is_file():
            raise UserError(f"nothing to resume: {self.checkpoint_path} does not exist; start without --resume")
        state = torch.load(self.checkpoint_path, map_location=self.ranks.device, weights_only=True)
        self.network.load_state_dict(state["model"])
        self.average = state["average"]
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.elapsed, self.log = state["step"], state["elapsed"], state["log"]
        # Other images, other augmentation than the first process began with.
        torch.manual_seed(self._c.seed + 1000 * self.ranks.rank + 1_000_003 * self.step)
