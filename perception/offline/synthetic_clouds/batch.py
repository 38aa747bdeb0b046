"""Training clouds: configuration of the synthetic ones, a batch, sources of batches, random numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from toolee_robot.errors import UserError
from toolee_robot.perception.pose.canonical import PATCHES, POINTS, CanonicalCloud


@dataclass(frozen=True)
class CloudConfig:
    """Distributions of the synthetic clouds; shares are probabilities.

    Attributes:
        distance: Range of the EE's distance [m].
        near_share: Share of the clouds whose distance is at most `near`.
        near: That distance [m].
        field: Half of the field of view to the right and down, as tangents.
        focal: Range of the focal length [px].
        kinect_share: Share with the focal length of a Kinect v2.
        hand_share: Share with a hand on the handle.
        occluder_share: Share with an occluder.
        mask_error_share: Share with an imperfect mask.
        chunk_share: Share whose mask misses a piece.
        cleaned_share: Share whose flying pixels are removed.
        negative_share: Share of negatives.
        max_occlusion: Largest occlusion of a positive, in [0, 1].
        sensor_level: Factor on the nominal sensor's noise; None: random sensors.
        radius: Radius [m] of the crop around the EE; None: the category's own.
        other_cut_share: Share whose mask is cut at another radius, as a detector's or another method's may be.
        other_cut: Range of the factor on the radius of such a cut.
        circle_share: Share of these that are circles in the image, as the paper's.
        border_share: Share in which the image ends near the EE.
        rest: Whether the rest of the tool is seen.
        rest_error_share: Share with an imperfect mask of the rest.
        rest_chunk_share: Share whose mask of the rest misses a piece.
        rest_gap_share: Share whose rest begins up to `rest_gap` beyond the cut.
        rest_gap: Largest such gap [m].
        wrong_rest_share: Share with another tool's rest.
        guessed: Whether the mask's pixels without depth are included, at a completed depth.
        points: Points that the network takes.
        ordered: The first so many of them are farthest-point samples.
    """

    distance: tuple[float, float] = (0.35, 1.1)
    near_share: float = 0.25
    near: float = 0.75
    field: tuple[float, float] = (0.5, 0.42)
    focal: tuple[float, float] = (350.0, 700.0)
    kinect_share: float = 0.5
    hand_share: float = 0.85
    occluder_share: float = 0.4
    mask_error_share: float = 0.8
    chunk_share: float = 0.15
    cleaned_share: float = 0.8
    negative_share: float = 0.12
    max_occlusion: float = 0.7
    sensor_level: float | None = None
    radius: float | None = None
    other_cut_share: float = 0.5
    other_cut: tuple[float, float] = (0.5, 1.65)
    circle_share: float = 0.35
    border_share: float = 0.08
    rest: bool = True
    rest_error_share: float = 0.7
    rest_chunk_share: float = 0.3
    rest_gap_share: float = 0.5
    rest_gap: float = 0.02
    wrong_rest_share: float = 0.02
    guessed: bool = True
    points: int = POINTS
    ordered: int = PATCHES


@dataclass(frozen=True)
class CloudBatch:
    """Canonical clouds with their truth, a batch of B.

    Attributes:
        points: (B, 512, 3) [m]; see `CanonicalCloud` for this and the next five.
        completed: (B, 512).
        centre: (B, 3) [m].
        R_canonical: (B, 3, 3).
        rest: (B, 256, 3) [m].
        rest_known: (B,) bool.
        R: Orientation of the EE in the canonical frame, (B, 3, 3).
        p: Position of the EE in the canonical frame, (B, 3) [m].
        direction: Direction tokens, given for all, (B, 5).
        spin_pixels: Pixels in the mask that show the spin, (B,).
        category: Claimed category, (B,).
        item: Row of the surface samples, (B,).
        positive: Whether the mask shows an EE of that category, (B,) bool.
        visible: Visible points at the camera's resolution, (B,).
        occlusion: In [0, 1], (B,).
        distance: Distance of the EE, (B,) [m].
    """

    points: Tensor
    completed: Tensor
    centre: Tensor
    R_canonical: Tensor
    rest: Tensor
    rest_known: Tensor
    R: Tensor
    p: Tensor
    direction: Tensor
    spin_pixels: Tensor
    category: Tensor
    item: Tensor
    positive: Tensor
    visible: Tensor
    occlusion: Tensor
    distance: Tensor

    def __len__(self) -> int:
        return len(self.points)

    @property
    def cloud(self) -> CanonicalCloud:
        """The part that an estimator gets."""
        seen = self.points, self.completed, self.centre, self.R_canonical
        return CanonicalCloud(*seen, self.visible, self.rest, self.rest_known)

    @classmethod
    def of(cls, cloud: CanonicalCloud, R: Tensor, p: Tensor, **about: Tensor) -> CloudBatch:
        """Make a batch.

        Args:
            cloud: The canonical clouds.
            R: Orientation of each EE, (B, 3, 3), camera frame.
            p: Position of each EE, (B, 3) [m], camera frame.
            **about: The remaining fields.

        Returns:
            The batch.
        """
        return cls(
            points=cloud.points,
            completed=cloud.completed,
            centre=cloud.centre,
            R_canonical=cloud.R,
            rest=cloud.rest,
            rest_known=cloud.rest_known,
            R=cloud.R @ R,
            p=torch.einsum("bij,bj->bi", cloud.R, p - cloud.centre),
            **about,
        )

    def select(self, index: Tensor) -> CloudBatch:
        """The rows of an index or mask."""
        return CloudBatch(*(getattr(self, f.name)[index] for f in fields(self)))

    @staticmethod
    def cat(batches: list[CloudBatch]) -> CloudBatch:
        """Several batches joined."""
        return CloudBatch(*(torch.cat([getattr(b, f.name) for b in batches]) for f in fields(CloudBatch)))


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
