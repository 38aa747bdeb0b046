"""Generative processes and rectified flow: from noise at t = 0 to the pose at t = 1.

Lipman et al., "Flow Matching for Generative Modeling", ICLR 2023; Liu et al., "Flow Straight and Fast", ICLR 2023.
A process defines what a network learns and which ordinary differential equation leads from noise to data; a sampler
solves that equation. So the same network can be sampled with a few Euler steps or with the paper's RK45.
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
    """Training examples of the network.

    Attributes:
        u: Noised data, (B, K, D).
        t: Times, (B, K).
        goal: Output wanted there, (B, K, D).
    """

    u: Tensor
    t: Tensor
    goal: Tensor


class Process(Protocol):
    """A generative process du / dtau = velocity, from noise at t = start to data at t = end.

    Attributes:
        start: Time of noise.
        end: Time of data.
    """

    @property
    def start(self) -> float: ...
    @property
    def end(self) -> float: ...

    def noised(self, target: Tensor, draws: int, generator: torch.Generator) -> Noised:
        """Noised training examples.

        Args:
            target: Data, (B, D).
            draws: Examples per target, K.
            generator: Draws noise and times; on the targets' device.

        Returns:
            The examples, (B, K, ...).
        """

    def prior(self, noise: Tensor) -> Tensor:
        """State u at t = start from standard normal noise."""

    def velocity(self, field: Field, u: Tensor, t: Tensor) -> Tensor:
        """The velocity du / dtau from the network's output.

        Args:
            field: The network.
            u: (B, K, D).
            t: (B, K).

        Returns:
            (B, K, D).
        """

    def tau(self, t: Tensor) -> Tensor:
        """The integration variable at t, in which trajectories are straightest."""

    def rate(self, t: Tensor) -> Tensor:
        """The derivative dtau / dt."""

    def finish(self, field: Field, u: Tensor) -> Tensor:
        """Make data of the state at the end of the integration.

        Args:
            field: The network.
            u: State at t = end, (B, K, D).

        Returns:
            The data, (B, K, D).
        """


Sampler = Callable[[Process, Field, Tensor], Tensor]
"""From a process, its trained network and standard normal noise (B, K, D) to data (B, K, D)."""


class RectifiedFlow:
    """Rectified flow: straight lines from noise to data; the network predicts their velocity."""

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
    """Euler's method with equal steps in t. Heun's method and more steps give no better accuracy for `RectifiedFlow`.

    Attributes:
        steps: Number of steps.
    """

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
