"""Random numbers on a device, from one seed."""

from __future__ import annotations

import torch
from torch import Tensor


class TorchRng:
    """A seeded torch generator with the distributions that the clouds need.

    Args:
        device: torch device of the numbers.
        seed: Seed.
    """

    def __init__(self, device: torch.device | str, seed: int) -> None:
        self.device = torch.device(device)
        self.generator = torch.Generator(self.device).manual_seed(seed)

    def uniform(self, n: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        """Draw uniformly distributed numbers.

        Args:
            n: How many.
            low: Lower bound, included.
            high: Upper bound, excluded.

        Returns:
            The numbers, (n,).
        """
        return low + (high - low) * torch.rand(n, device=self.device, generator=self.generator)

    def normal(self, *shape: int) -> Tensor:
        """Standard normal numbers of this shape."""
        return torch.randn(*shape, device=self.device, generator=self.generator)

    def integers(self, low: int, high: int, *shape: int) -> Tensor:
        """Draw uniformly distributed integers.

        Args:
            low: Lower bound, included.
            high: Upper bound, excluded.
            *shape: Shape of the result.

        Returns:
            The integers, of that shape.
        """
        return torch.randint(low, high, shape, device=self.device, generator=self.generator)

    def rotations(self, n: int) -> Tensor:
        """(n, 3, 3), uniform on SO(3)."""
        w, x, y, z = torch.nn.functional.normalize(self.normal(n, 4), dim=-1).unbind(-1)
        rows = [
            1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
            2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
        ]  # fmt: skip
        return torch.stack(rows, -1).view(-1, 3, 3)
