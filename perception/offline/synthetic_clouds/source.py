"""Sources of training clouds."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch

from toolee_robot.errors import UserError
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch


class CloudSource(ABC):
    """Endless clouds on one device, from one seed."""

    @abstractmethod
    def generate(self, n: int) -> CloudBatch:
        """Up to n clouds: those that show too little are dropped."""

    @abstractmethod
    def reseed(self, seed: int) -> None:
        """Start another sequence of clouds."""

    def collect(self, n: int, chunk: int) -> CloudBatch:
        """Generate a given number of clouds.

        Args:
            n: Number of clouds.
            chunk: Clouds per call of `generate`.

        Returns:
            Exactly n clouds.
        """
        batches: list[CloudBatch] = []
        while sum(map(len, batches)) < n:
            batches.append(self.generate(chunk))
        return CloudBatch.cat(batches).select(torch.arange(n, device=batches[0].points.device))


class Mixture(CloudSource):
    """A mixture of two sources.

    Args:
        first: Source of the other clouds.
        second: Source of a share of the clouds.
        share: That share, in [0, 1].

    Raises:
        UserError: The share is outside of [0, 1].
    """

    def __init__(self, first: CloudSource, second: CloudSource, share: float) -> None:
        if not 0.0 <= share <= 1.0:
            raise UserError(f"a share of {share} of the clouds: give one from 0 to 1", code="user.share")
        self._first, self._second, self._share = first, second, share

    def generate(self, n: int) -> CloudBatch:
        """See `CloudSource`."""
        of_second = round(self._share * n)
        asked = (self._first, n - of_second), (self._second, of_second)
        return CloudBatch.cat([source.generate(count) for source, count in asked if count])

    def reseed(self, seed: int) -> None:
        """See `CloudSource`."""
        self._first.reseed(seed)
        self._second.reseed(seed + 1)
