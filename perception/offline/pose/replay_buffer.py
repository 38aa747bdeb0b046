"""Replay buffer of training clouds on the device."""

from __future__ import annotations

from dataclasses import fields

import torch

from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch


class ReplayBuffer:
    """A ring buffer of clouds on the device: new ones replace the oldest, batches are drawn at random.

    Args:
        first: The first clouds.
        capacity: Number of clouds that it holds.

    Attributes:
        made: Number of clouds added so far.
    """

    def __init__(self, first: CloudBatch, capacity: int) -> None:
        self._rows = {
            f.name: torch.empty(
                (capacity, *getattr(first, f.name).shape[1:]),
                dtype=getattr(first, f.name).dtype,
                device=first.points.device,
            )
            for f in fields(CloudBatch)
        }
        self._capacity, self._filled, self._next = capacity, 0, 0
        self.made = 0
        self.add(first)

    def add(self, batch: CloudBatch) -> None:
        """Add clouds in place of the oldest ones."""
        device = batch.points.device
        index = (self._next + torch.arange(len(batch), device=device)) % self._capacity
        for name, rows in self._rows.items():
            rows[index] = getattr(batch, name)
        self._next = (self._next + len(batch)) % self._capacity
        self._filled = min(self._filled + len(batch), self._capacity)
        self.made += len(batch)

    def draw(self, n: int, generator: torch.Generator) -> CloudBatch:
        """Draw clouds at random, with replacement.

        Args:
            n: How many.
            generator: Random generator, on the buffer's device.

        Returns:
            The clouds.
        """
        index = torch.randint(self._filled, (n,), device=generator.device, generator=generator)
        return CloudBatch(**{name: rows[index] for name, rows in self._rows.items()})
