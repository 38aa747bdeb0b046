"""The training loop of every network: processes, budget, averaged weights, log and checkpoints."""

from __future__ import annotations

import copy
import json
import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor, nn

from toolee_robot.end_effectors import label_of
from toolee_robot.errors import TooleeError, UserError, words_of
from toolee_robot.perception.offline.training.options import TrainingOptions
from toolee_robot.perception.precision import torch_device
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.processes import interrupts_held

Network = TypeVar("Network", bound=nn.Module)


@dataclass(frozen=True)
class Distributed:
    """This process among those that train together.

    Attributes:
        rank: Index of this process.
        world: Number of processes.
        device: Its torch device.
    """

    rank: int
    world: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether this process logs and writes."""
        return self.rank == 0

    @property
    def device_name(self) -> str:
        """Number and name of the devices."""
        name = torch.cuda.get_device_name(self.device) if self.device.type == "cuda" else "CPU"
        return f"{self.world} x {name}"

    def broadcast(self, value: float) -> float:
        """Rank 0's value, on every rank."""
        if self.world == 1:
            return value
        tensor = torch.tensor([value], dtype=torch.float64, device=self.device)
        dist.broadcast(tensor, 0)
        return float(tensor.item())

    def wrap_ddp(self, module: nn.Module) -> nn.Module:
        """The module wrapped so that its gradients are averaged over the ranks."""
        if self.world == 1:
            return module
        ids = [self.device.index] if self.device.type == "cuda" else None
        return nn.parallel.DistributedDataParallel(module, device_ids=ids)


@contextmanager
def init_distributed(device: str = "auto") -> Iterator[Distributed]:
    """Join the processes that torchrun started; alone without torchrun.

    Args:
        device: torch device; "auto": a GPU of its own for each process where there are GPUs, else the CPU.

    Yields:
        This process's place among them.
    """
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if device == "auto":
        device = f"cuda:{os.environ.get('LOCAL_RANK', '0')}" if torch.cuda.is_available() else "cpu"
    chosen = torch_device(device)
    if chosen.type == "cuda":
        torch.cuda.set_device(chosen)
    if world > 1:
        dist.init_process_group("nccl" if chosen.type == "cuda" else "gloo")
    try:
        yield Distributed(int(os.environ.get("RANK", "0")), world, chosen)
    finally:
        if world > 1:
            dist.destroy_process_group()


def with_weights(network: Network, weights: Mapping[str, Tensor]) -> Network:
    """A copy of a network with other weights, rounded to half precision, as they will be stored."""
    net = copy.deepcopy(network).requires_grad_(False)
    rounded = {k: v.half().float() if v.is_floating_point() else v for k, v in weights.items()}
    net.load_state_dict(rounded, strict=False)  # without the numbers of batches
    return net.eval()


class TrainingRun(ABC):
    """The state of a training: network, average, optimiser, clock, log. It resumes from a checkpoint in its folder.

    Args:
        options: Options of the training.
        out: Folder for checkpoint, weights and log.
        distributed: This process among those that train together.
        network: The network that is trained.
        module: The network, or a module that holds it and computes its losses.

    Attributes:
        name: Name of the weights.
        checkpoint: File name of the checkpoint in the output folder.
        log_name: File name of the log there, one JSON object per line.
        log_seconds: Least time between entries of the log [s].
        averages_buffers: Whether running statistics are averaged as the weights are; otherwise the newest are taken.
        start: Weights that the training started from; empty: none that count.
        start_share: Their share in the exported weights, for what they knew (Wortsman et al. 2022).
    """

    name: str
    checkpoint: str = "checkpoint.pt"
    log_name: str = "log.jsonl"
    log_seconds: float = 0.0
    averages_buffers: bool = True
    start_share: float = 0.0

    def __init__(
        self, options: TrainingOptions, out: Path, distributed: Distributed, network: nn.Module, module: nn.Module
    ) -> None:
        self.distributed, self.network, self.module, self.out = distributed, network, module, out
        self._options = options
        self.start: dict[str, Tensor] = {}
        self.average = {k: v.detach().clone() for k, v in network.state_dict().items()}
        weights = {k for k, _ in network.named_parameters()}
        self._lerped = [
            k for k, v in self.average.items() if v.is_floating_point() and (self.averages_buffers or k in weights)
        ]
        self.optimizer = self.make_optimizer()
        self.step, self.elapsed = 0, 0.0
        self.log: list[dict[str, Any]] = []
        self.checkpoint_path = out / self.checkpoint
        self.resumed = self.checkpoint_path.is_file()
        out.mkdir(parents=True, exist_ok=True)

    @abstractmethod
    def losses(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """The losses of the next batch, which are summed, and further values for the log."""

    @abstractmethod
    def write(self) -> None:
        """Write the averaged weights with their description into the output folder."""

    def make_optimizer(self) -> torch.optim.Optimizer:
        """AdamW, without decay for one-dimensional parameters."""
        parameters = list(self.network.parameters())
        decayed = {"params": [p for p in parameters if p.ndim > 1], "weight_decay": self._options.weight_decay}
        plain = {"params": [p for p in parameters if p.ndim <= 1], "weight_decay": 0.0}
        return torch.optim.AdamW([decayed, plain], lr=self._options.lr)

    def schedule(self, progress: float) -> float:
        """Factor on the learning rate after the warm-up, at a share of the budget: cosine decay to 1 %."""
        return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))

    def reseed(self) -> None:
        """Seed anew after a resumption, so that examples differ from those of the first process."""
        torch.manual_seed(self._options.seed + 1000 * self.distributed.rank + 1_000_003 * self.step)

    def prepare(self) -> nn.Module:
        """Prepare the first step; returns the module that the ranks share."""
        return self.module

    def grow(self) -> dict[str, float]:
        """Add new examples; returns values for the log."""
        return {}

    @property
    def progress(self) -> float:
        """Share of the budget that is used, 1 at its end."""
        return self._options.progress(self.elapsed / 60, self.step)

    def loop(self) -> None:
        """Train until the budget or the session is used up; an interrupt loses no step.

        Raises:
            TooleeError: The loss is not finite.
            UserError: The checkpoint is damaged, or cannot be written.
        """
        options, distributed = self._options, self.distributed
        if self.resumed:
            self._restore()
        self.module = distributed.wrap_ddp(self.prepare())
        parameters = sum(p.numel() for p in self.network.parameters())
        begun = "resumed" if self.resumed else "start"
        self.record({"event": begun, "device": distributed.device_name, "parameters": parameters})
        self.module.train()
        session = math.inf if options.session_minutes is None else 60 * options.session_minutes
        end = self.elapsed + session
        began = time.monotonic() - self.elapsed
        last_checkpoint, last_log, last_step = self.elapsed, self.elapsed, self.step
        try:
            while self.progress < 1.0 and self.elapsed < end:
                rate = options.lr * min(1.0, (self.step + 1) / options.warmup_steps) * self.schedule(self.progress)
                for group in self.optimizer.param_groups:
                    group["lr"] = rate
                with interrupts_held():  # they come between two steps
                    values, norm = self._optimise()
                    self.step += 1
                if self.step % options.log_every and self.step != options.max_steps:
                    continue
                # The ranks must end with the same step.
                self.elapsed = distributed.broadcast(time.monotonic() - began)
                entry = {name: float(value) for name, value in values.items()} | {"gradient_norm": float(norm)}
                self._stop_unless_finite(entry)
                more = self.grow()
                if self.elapsed - last_log >= self.log_seconds:
                    seconds = max(self.elapsed - last_log, 1e-9)
                    per_second = (self.step - last_step) * options.batch * distributed.world / seconds
                    self.record({**entry, "lr": rate, "examples_per_second": per_second, **more})
                    last_log, last_step = self.elapsed, self.step
                if self.elapsed - last_checkpoint > 60 * options.checkpoint_minutes:
                    last_checkpoint = self.elapsed
                    self._checkpoint()
        except KeyboardInterrupt:
            self.elapsed = time.monotonic() - began
            if all(bool(value.isfinite().all()) for value in self.average.values()):  # it is looked at now and then
                self.record({"event": "interrupted"})
                self._save()
            raise
        self._checkpoint()

    def record(self, values: dict[str, Any]) -> None:
        """Write an entry to the terminal and the log.

        Args:
            values: The entry; one without an "event" is also kept in memory.
        """
        if not self.distributed.first:
            return
        entry = {"step": self.step, "minutes": round(self.elapsed / 60, 4), **_rounded(values)}
        short = {key: value for key, value in entry.items() if not isinstance(value, dict)}
        print(f"{self.name}: {json.dumps(short)}", flush=True)
        for key, table in entry.items():
            if isinstance(table, dict):
                print(f"  {label_of(key)}: {json.dumps(table.get('average', table))}", flush=True)
        with (self.out / self.log_name).open("a") as file:
            file.write(json.dumps(entry) + "\n")
        if "event" not in values:
            self.log.append(entry)

    def averaged(self) -> dict[str, Tensor]:
        """The averaged weights as they are exported; with the share of `start`."""
        found = {k: v for k, v in self.average.items() if not k.endswith("num_batches_tracked")}
        known = {k: v for k, v in self.start.items() if k in found and v.is_floating_point()}
        return found | {k: torch.lerp(found[k], v, self.start_share) for k, v in known.items()}

    def _optimise(self) -> tuple[dict[str, Tensor], Tensor]:
        losses, more = self.losses()
        total = sum(losses.values(), torch.zeros((), device=self.distributed.device))
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(total)
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), self._options.clip_norm)
        self.optimizer.step()
        self._update_average()
        return {"loss": total.detach(), **{k: v.detach() for k, v in (losses | more).items()}}, norm

    @torch.no_grad()
    def _update_average(self) -> None:
        decay = min(self._options.ema, (1 + self.step) / (10 + self.step))
        state = self.network.state_dict()
        torch._foreach_lerp_([self.average[k] for k in self._lerped], [state[k] for k in self._lerped], 1 - decay)
        for name in self.average.keys() - set(self._lerped):
            self.average[name].copy_(state[name])

    def _stop_unless_finite(self, values: dict[str, float]) -> None:
        bad = [name for name, value in values.items() if not math.isfinite(value)]
        if bad:
            raise TooleeError(
                f"the training of {self.name} stopped at step {self.step}: {', '.join(bad)} not finite. The last "
                f"good state is {self.checkpoint_path}. Lower lr or clip_norm, then run the same command again",
                code="toolee.training_diverged",
            )

    def _checkpoint(self) -> None:
        if self.distributed.first:
            self._save()
            self.write()

    def _save(self) -> None:
        """Write the state from which the training goes on."""
        if not self.distributed.first:
            return
        state = {
            "model": self.network.state_dict(),
            "average": self.average,
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "elapsed": self.elapsed,
            "log": self.log,
        }
        with interrupts_held():
            stream = BytesIO()
            torch.save(state, stream)
            write_atomic(self.checkpoint_path, stream.getbuffer())

    def _restore(self) -> None:
        path = self.checkpoint_path
        try:
            state = torch.load(path, map_location=self.distributed.device, weights_only=True)
            self.network.load_state_dict(state["model"])
            self.average = state["average"]
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.elapsed, self.log = state["step"], state["elapsed"], state["log"]
        except (OSError, EOFError, RuntimeError, KeyError, TypeError, ValueError, UnpicklingError) as error:
            raise UserError(
                f"cannot continue from {path}, which is damaged or of another network. Give another --out, or "
                f"delete it to begin again. {words_of(error).splitlines()[0]}",
                code="user.checkpoint",
            ) from error
        self.reseed()


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Values rounded to five significant digits for the log."""
    return {k: float(f"{v:.5g}") if isinstance(v, float) else v for k, v in values.items()}
