"""The paper's sampler: Dormand and Prince's Runge-Kutta 5(4) with an adaptive step, on the device, in batches.

Each cloud has its own step size, so that a result does not depend on the rest of the batch (the published code passes
the whole batch to one solver).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from toolee_robot.errors import TooleeError
from toolee_robot.perception.pose.processes.flow import Field, Process

_C = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
_A = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_E = (-71 / 57600, 0.0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40)


@dataclass(frozen=True)
class Rk45:
    """Adaptive sampler; see `flow.Sampler`.

    Attributes:
        rtol: Relative tolerance of each step.
        atol: Absolute tolerance of each step.
    """

    rtol: float = 1e-5
    atol: float = 1e-5

    def __call__(self, process: Process, field: Field, noise: Tensor) -> Tensor:
        """Solve the process's equation from noise to data."""
        K = noise.shape[1]

        def derivative(t: Tensor, u: Tensor) -> Tensor:
            each = t[:, None].expand(-1, K)
            v = process.velocity(field, u.to(noise.dtype), each.to(noise.dtype)).double()
            return v * process.rate(t)[:, None, None]

        u = solve(derivative, process.prior(noise).double(), process.start, process.end, self.rtol, self.atol)
        return process.finish(field, u.to(noise.dtype))


def solve(
    derivative: Callable[[Tensor, Tensor], Tensor],
    y: Tensor,
    start: float,
    end: float,
    rtol: float = 1e-5,
    atol: float = 1e-5,
    most_steps: int = 2000,
) -> Tensor:
    """Solve dy/dt = derivative(t, y), with a step size for each row.

    Args:
        derivative: From t (B,) and y (B, ...) to dy/dt (B, ...).
        y: Initial values at t = start, (B, ...).
        start: Initial time.
        end: Final time.
        rtol: Relative tolerance of each step.
        atol: Absolute tolerance of each step.
        most_steps: Largest number of steps.

    Returns:
        y at t = end, (B, ...).

    Raises:
        TooleeError: The steps do not reach the end.
    """
    wide = (-1, *[1] * (y.dim() - 1))
    t = torch.full((len(y),), start, device=y.device, dtype=y.dtype)
    h = torch.full_like(t, 0.01 * (end - start))
    least = 1e-7 * abs(end - start)
    k0 = derivative(t, y)
    for _ in range(most_steps):
        left = end - t
        if not bool((left != 0).any()):
            return y
        h = torch.where(h.abs() >= left.abs(), left, h)
        ks = [k0]
        for c, row in zip(_C[1:], _A, strict=True):
            step = sum((a * k for a, k in zip(row, ks, strict=True)), torch.zeros_like(y))
            ahead = y + h.view(wide) * step
            ks.append(derivative(t + c * h, ahead))
        error = h.view(wide) * sum((e * k for e, k in zip(_E, ks, strict=True)), torch.zeros_like(y))
        scale = atol + rtol * torch.maximum(y.abs(), ahead.abs())
        norm = (error / scale).square().flatten(1).mean(1).sqrt()
        accepted = ((norm <= 1) | (h.abs() <= least)) & (left != 0)
        t = torch.where(accepted, torch.where(h == left, torch.full_like(t, end), t + h), t)
        y = torch.where(accepted.view(wide), ahead, y)
        k0 = torch.where(accepted.view(wide), ks[-1], k0)
        factor = (0.9 * norm.clamp_min(1e-10) ** -0.2).clamp(0.2, 10.0)
        h = h * torch.where(accepted, factor, factor.clamp_max(1.0))
    raise TooleeError(
        f"RK45 needed over {most_steps} steps: the network's field is not smooth, train it longer",
        code="toolee.stiff_ode",
    )
