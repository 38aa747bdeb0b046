"""EDM: Karras et al., "Elucidating the Design Space of Diffusion-Based Generative Models", NeurIPS 2022."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from toolee_robot.perception.pose.processes.flow import Field, Noised


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
