"""Generative processes of pose networks, from noise to the pose, and their solver.

A process defines what a network learns and which ordinary differential equation leads from noise to data; a sampler
solves that equation. So the same network can be sampled with a few Euler steps or with the paper's RK45.
"""

from __future__ import annotations

import math
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


@dataclass(frozen=True)
class Euler:
    """Euler's method with equal steps in t. Heun's method and more steps gave no better accuracy.

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


@dataclass(frozen=True)
class Edm:
    """EDM's preconditioned denoising; see `Process`.

    t in [0, 1] runs over the noise schedule of Karras et al. (rho = 7) from `high` to `low`.

    Attributes:
        spread: Standard deviation of the data.
        low: Lowest noise level.
        high: Highest noise level.
        start: Time of pure noise.
        end: Time of the data.
    """

    spread: float = 0.6
    low: float = 0.005
    high: float = 10.0
    start: float = 0.0
    end: float = 1.0

    def noised(self, target: Tensor, draws: int, generator: torch.Generator) -> Noised:
        """See `Process`; the noise levels are log-normal."""
        B, D = target.shape
        n = torch.randn(B, draws, 1, device=target.device, generator=generator)
        sigma = (1.2 * n - 1.2).exp()
        x = target[:, None] + sigma * torch.randn(B, draws, D, device=target.device, generator=generator)
        skip, out, scale = self._factors(sigma)
        return Noised(scale * x, sigma[..., 0].log() / 4, (target[:, None] - skip * x) / out)

    def prior(self, noise: Tensor) -> Tensor:
        """See `Process`."""
        return noise * self.high

    def velocity(self, field: Field, u: Tensor, t: Tensor) -> Tensor:
        """See `Process`: du / dsigma."""
        sigma = self.tau(t)[..., None]
        return (u - self._denoised(field, u, sigma)) / sigma

    def tau(self, t: Tensor) -> Tensor:
        """The noise level sigma at t."""
        return self._root(t) ** 7

    def rate(self, t: Tensor) -> Tensor:
        """See `Process`."""
        return 7 * self._root(t) ** 6 * (self.low ** (1 / 7) - self.high ** (1 / 7))

    def finish(self, field: Field, u: Tensor) -> Tensor:
        """See `Process`: the denoised data given u."""
        return self._denoised(field, u, torch.full_like(u[..., :1], self.low))

    def _root(self, t: Tensor) -> Tensor:
        return self.high ** (1 / 7) + t * (self.low ** (1 / 7) - self.high ** (1 / 7))

    def _factors(self, sigma: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        total = sigma**2 + self.spread**2
        return self.spread**2 / total, sigma * self.spread / total.sqrt(), 1 / total.sqrt()

    def _denoised(self, field: Field, u: Tensor, sigma: Tensor) -> Tensor:
        skip, out, scale = self._factors(sigma)
        return skip * u + out * field(scale * u, sigma[..., 0].log() / 4)


@dataclass(frozen=True)
class VarianceExploding:
    """The process u_t = data + sigma(t) z with sigma(t) = low (high / low)^t.

    The network predicts sigma times the score, which is -z. Sampled from t = start (the paper's: sigma is
    about 1) down to t = end, with one denoising step at the end.

    Attributes:
        low: Lowest noise level.
        high: Highest noise level.
        start: Time at which sampling starts.
        end: Time at which sampling ends.
    """

    low: float = 0.01
    high: float = 50.0
    start: float = 0.55
    end: float = 1e-5

    def noised(self, target: Tensor, draws: int, generator: torch.Generator) -> Noised:
        """See `Process`. With the loss weight sigma^2 the score's error becomes that of z."""
        B, D = target.shape
        z = torch.randn(B, draws, D, device=target.device, generator=generator)
        t = self.end + (1 - self.end) * torch.rand(B, draws, device=target.device, generator=generator)
        return Noised(target[:, None] + self.tau(t)[..., None] * z, t, -z)

    def prior(self, noise: Tensor) -> Tensor:
        """See `Process`."""
        return noise * self.low * (self.high / self.low) ** self.start

    def velocity(self, field: Field, u: Tensor, t: Tensor) -> Tensor:
        """See `Process`: du / dsigma of the probability-flow equation, -sigma times the score."""
        return -field(u, t)

    def tau(self, t: Tensor) -> Tensor:
        """The noise level sigma at t."""
        return self.low * (self.high / self.low) ** t

    def rate(self, t: Tensor) -> Tensor:
        """See `Process`."""
        return math.log(self.high / self.low) * self.tau(t)

    def finish(self, field: Field, u: Tensor) -> Tensor:
        """See `Process`: the mean of the data given u (Tweedie)."""
        t = torch.full(u.shape[:2], self.end, device=u.device, dtype=u.dtype)
        return u + self.low * field(u, t)
