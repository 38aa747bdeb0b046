"""The generative process behind the samples: rectified flow from noise at t = 0 to the pose at t = 1.

Lipman et al., "Flow Matching for Generative Modeling", ICLR 2023; Liu et al., "Flow Straight and Fast", ICLR 2023.
A process says what a network learns and which ordinary differential equation leads from noise to data; a sampler
solves that equation. So the same network can be solved by a few Euler steps or by the paper's RK45.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

Field = Callable[[Tensor, Tensor], Tensor]
"""The network for fixed clouds: u (B, K, D), t (B, K) -> (B, K, D)."""


@dataclass(frozen=True)
class Noised:
    """Training examples of the network: its inputs u (B, K, D), t (B, K) and the output wanted there, `goal`."""

    u: Tensor
    t: Tensor
    goal: Tensor


class Process(Protocol):
    """How data becomes noise, and the way back: du / dtau = velocity, from t = start to t = end."""

    @property
    def start(self) -> float: ...
    @property
    def end(self) -> float: ...

    def noised(self, target: Tensor, draws: int, generator: torch.Generator) -> Noised:
        """`draws` (K) training examples for each target (B, D)."""
        ...

    def prior(self, noise: Tensor) -> Tensor:
        """u at t = start from standard normal noise."""
        ...

    def velocity(self, field: Field, u: Tensor, t: Tensor) -> Tensor:
        """du / dtau at u (B, K, D), t (B, K)."""
        ...

    def tau(self, t: Tensor) -> Tensor:
        """The variable in which the way is straightest."""
        ...

    def rate(self, t: Tensor) -> Tensor:
        """dtau / dt."""
        ...

    def finish(self, field: Field, u: Tensor) -> Tensor:
        """Data from u at t = end."""
        ...


Sampler = Callable[[Process, Field, Tensor], Tensor]
"""Data (B, K, D) from a process, its trained network, and standard normal noise (B, K, D)."""


class RectifiedFlow:
    """Straight lines from noise to data; the network says their velocity."""

    start, end = 0.0, 1.0

    def noised(self, target: Tensor, draws: int, generator: torch.Generator) -> Noised:
        """See `Process`."""
        B, D = target.shape
        noise = torch.randn(B, draws, D, device=target.device, generator=generator)
        t = torch.rand(B, draws, device=target.device, generator=generator)
        goal = target[:, None] - noise
        return Noised(noise + t[..., None] * goal, t, goal)

    def prior(self, noise: Tensor) -> Tensor:
        """See `Process`."""
        return noise

    def velocity(self, field: Field, u: Tensor, t: Tensor) -> Tensor:
        """See `Process`."""
        return field(u, t)

    def tau(self, t: Tensor) -> Tensor:
        """See `Process`."""
        return t

    def rate(self, t: Tensor) -> Tensor:
        """See `Process`."""
        return torch.ones_like(t)

    def finish(self, field: Field, u: Tensor) -> Tensor:  # noqa: ARG002 - the way ends at the data
        """See `Process`."""
        return u


@dataclass(frozen=True)
class Euler:
    """So many equal steps in t; Heun's method and more steps measured no better for `RectifiedFlow`."""

    steps: int = 5

    def __call__(self, process: Process, field: Field, noise: Tensor) -> Tensor:
        """See `Sampler`."""
        u = process.prior(noise)
        grid = torch.linspace(process.start, process.end, self.steps + 1, device=u.device, dtype=u.dtype)
        tau = process.tau(grid)
        for i in range(self.steps):
            t = grid[i].expand(u.shape[:2])
            u = u + (tau[i + 1] - tau[i]) * process.velocity(field, u, t)
        return process.finish(field, u)
