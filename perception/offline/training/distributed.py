"""The processes that `torchrun` starts to train one network on several GPUs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import nn

from toolee_robot.perception.precision import torch_device


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
