"""The variance-exploding process: Song et al., "Score-Based Generative Modeling through SDEs", ICLR 2021."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolee_robot.perception.pose.processes.flow import Field, Noised


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
