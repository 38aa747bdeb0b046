"""Stored clouds of rendered images: what a depth camera and a detector's masks leave of an end effector.

The clouds of `generator.py` show tools alone in front of a plane, under random mask errors. These are of whole scenes,
under true masks and under those of a detector that was not trained on the images; or of whole tools, for the column of
the paper's Table I that estimates the tool's pose. `toolee_robot.perception.offline.rendered_clouds` makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError, UserError, words_of
from toolee_robot.frames import Array
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch, CloudConfig, CloudSource, TorchRng
from toolee_robot.perception.offline.synthetic_clouds.scene import DIRECTION_SIGMA, direction_token
from toolee_robot.perception.pose.canonical import (
    MIN_KEPT,
    MIN_POINTS,
    CanonicalCloud,
    canonicalize,
    masked_median,
    with_rest,
)
from toolee_robot.runtime.files import written_whole

MAX_POINTS, MAX_COMPLETED, MAX_REST = 1024, 512, 1024
"""Largest numbers of measured points, completed points and points of the rest that are stored per cloud; the
network takes 512 and 256.
"""


@dataclass(frozen=True, eq=False)
class RenderedClouds:
    """N clouds with their truth, camera frame.

    Attributes:
        points: Measured points of all clouds, one cloud after the other, (P, 3) float32 [m]; see `EeCloud`.
        guessed: Points of completed depth, likewise, (G, 3) float32 [m].
        rest: Points of the rest of the tool, likewise, (Q, 3) float32 [m].
        counts: How many of each belong to a cloud, (N, 3) int64.
        X_camera_ee: Pose of the EE, (N, 4, 4) float32.
        X_camera_tool: Pose of its tool, likewise.
        of_tool: Whether the cloud shows the whole tool, (N,) bool.
        p_camera_hand: Position of the hand, (N, 3) float32 [m]; NaN where unknown.
        category: Index of the category, (N,) int64.
        positive: Whether the mask shows an EE of that category, (N,) bool.
        visible: Number of points before thinning, (N,) int64.
        tells_spin: How many of these show the spin, (N,) int64.
        occlusion: In [0, 1], (N,) float32.
    """

    points: NDArray[np.float32]
    guessed: NDArray[np.float32]
    rest: NDArray[np.float32]
    counts: NDArray[np.int64]
    X_camera_ee: NDArray[np.float32]
    X_camera_tool: NDArray[np.float32]
    of_tool: NDArray[np.bool_]
    p_camera_hand: NDArray[np.float32]
    category: NDArray[np.int64]
    positive: NDArray[np.bool_]
    visible: NDArray[np.int64]
    tells_spin: NDArray[np.int64]
    occlusion: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.counts)

    @classmethod
    def cat(cls, several: Sequence[RenderedClouds]) -> RenderedClouds:
        """Several records joined."""
        many = [_none(), *several]
        return cls(*(np.concatenate([getattr(each, f.name) for each in many]) for f in fields(cls)))

    def check_kind(self, of_tool: bool) -> None:
        """Check that all clouds are of whole tools, or all of end effectors.

        Args:
            of_tool: Whether they must be of whole tools.

        Raises:
            UserError: Some are of the other kind.
        """
        if (self.of_tool != of_tool).any():
            wanted, given = ("whole tools", "end effectors") if of_tool else ("end effectors", "whole tools")
            raise UserError(
                f"--rendered: this training takes clouds of {wanted}, some of these are of {given}: make them with "
                "`benchmarks.published_clouds`, with --whole-tools or without"
            )

    def save(self, path: Path) -> None:
        """Write the clouds into one .npz file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as scratch, scratch.open("wb") as file:
            np.savez(file, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, path: Path) -> RenderedClouds:
        """Read the clouds.

        Args:
            path: The file.

        Raises:
            AssetError: The file is missing or damaged.
        """
        try:
            with np.load(path) as data:
                return cls(*(data[f.name] for f in fields(cls)))
        except (OSError, ValueError, KeyError) as error:
            raise AssetError(
                f"{path} holds no clouds: make them with `toolee train clouds` ({words_of(error)})",
                code="asset.unreadable",
            ) from error


def _none() -> RenderedClouds:
    """No cloud."""
    nothing = np.empty((0, 3))
    one = stored((nothing, nothing, nothing), 0, np.eye(4), np.eye(4), 0.0, np.random.default_rng(0))
    return RenderedClouds(*(getattr(one, f.name)[:0] for f in fields(one)))


def stored(
    clouds: tuple[Array, Array, Array],
    category: int,
    X_camera_ee: Array,
    X_camera_tool: Array,
    occlusion: float,
    rng: np.random.Generator,
) -> RenderedClouds:
    """A cloud as it is stored, thinned.

    Args:
        clouds: Measured points, completed points, and points of the rest of the tool, (N, 3) [m].
        category: Index of the category.
        X_camera_ee: Pose of the EE, 4x4.
        X_camera_tool: Pose of its tool, 4x4.
        occlusion: In [0, 1].
        rng: Random generator.

    Returns:
        The cloud, a positive.
    """
    sizes = MAX_POINTS, MAX_COMPLETED, MAX_REST
    points, completed, rest = (_thinned(x, n, rng).astype(np.float32) for x, n in zip(clouds, sizes, strict=True))
    return RenderedClouds(
        points,
        completed,
        rest,
        counts=np.array([[len(points), len(completed), len(rest)]]),
        X_camera_ee=np.array([X_camera_ee], np.float32),
        X_camera_tool=np.array([X_camera_tool], np.float32),
        of_tool=np.array([False]),
        p_camera_hand=np.full((1, 3), np.nan, np.float32),
        category=np.array([category]),
        positive=np.array([True]),
        visible=np.array([len(clouds[0])]),
        tells_spin=np.array([0]),
        occlusion=np.array([occlusion], np.float32),
    )


def _thinned(points: Array, most: int, rng: np.random.Generator) -> Array:
    return points if len(points) <= most else points[rng.choice(len(points), most, replace=False)]


class RenderedSource(CloudSource):
    """Endless draws from stored clouds; each time the network's points are drawn anew.

    Args:
        clouds: The stored clouds.
        device: torch device.
        seed: Seed of the draws.
        config: Its negative_share, radius, rest, guessed, points and ordered apply here, too.

    Raises:
        AssetError: There is nothing to draw from.
    """

    def __init__(self, clouds: RenderedClouds, device: torch.device | str, seed: int, config: CloudConfig) -> None:
        self._device, self._config = torch.device(device), config
        self._torch_rng = TorchRng(self._device, seed)

        def put(x: np.ndarray) -> Tensor:
            return torch.as_tensor(x, device=self._device)

        self._flat = put(clouds.points), put(clouds.guessed), put(clouds.rest)
        self._counts = put(clouds.counts)
        self._starts = self._counts.cumsum(0) - self._counts
        self._X, self._p_hand = put(clouds.X_camera_ee), put(clouds.p_camera_hand)
        self._category, self._positive = put(clouds.category), put(clouds.positive)
        self._visible, self._tells, self._occlusion = put(clouds.visible), put(clouds.tells_spin), put(clouds.occlusion)
        self._radius = put(np.array([config.radius or c.spec.radius for c in Category], np.float32))
        self._weights = put(_weights(clouds, config.negative_share))

    def reseed(self, seed: int) -> None:
        """See `CloudSource`."""
        self._torch_rng.generator.manual_seed(seed)

    def generate(self, n: int) -> CloudBatch:
        """See `CloudSource`."""
        return self.rows(torch.multinomial(self._weights, n, replacement=True, generator=self._torch_rng.generator))

    @torch.no_grad()
    def rows(self, which: Tensor) -> CloudBatch:
        """The stored clouds of these numbers (B,), without those that show too little; `item` is the number."""
        c, torch_rng = self._config, self._torch_rng
        points, valid = self._take(0, which, MAX_POINTS)
        rest, rest_valid = self._take(2, which, MAX_REST)
        category = self._category[which]
        completed = self._take(1, which, MAX_COMPLETED) if c.guessed else None
        cloud = canonicalize(points, valid, self._radius[category], torch_rng.generator, c.points, c.ordered, completed)
        # Scaled as at inference: the share of the thinned points that is kept, of all visible ones.
        visible = cloud.count / valid.sum(1).clamp_min(1) * self._visible[which]
        if c.rest:
            cloud = with_rest(cloud, rest, rest_valid, torch_rng.generator)
        X = self._X[which]
        result = CloudBatch.of(
            cloud,
            X[:, :3, :3],
            X[:, :3, 3],
            direction=self._direction(cloud, rest, rest_valid, self._p_hand[which]),
            spin_pixels=self._tells[which],
            category=category,
            item=which,
            positive=self._positive[which],
            visible=visible,
            occlusion=self._occlusion[which],
            distance=X[:, 2, 3],
        )
        return result.select((cloud.count >= MIN_KEPT) & (visible >= MIN_POINTS))

    def _take(self, kind: int, which: Tensor, most: int) -> tuple[Tensor, Tensor]:
        """Points (B, most, 3) of some clouds, and which of them are real (B, most)."""
        k = torch.arange(most, device=self._device)
        valid = k < self._counts[which, kind, None]
        flat = self._flat[kind]
        if not len(flat):
            return flat.new_zeros(*valid.shape, 3), valid
        rows = (self._starts[which, kind, None] + k).clamp(max=len(flat) - 1)
        return torch.where(valid[..., None], flat[rows], 0.0), valid

    def _direction(self, cloud: CanonicalCloud, rest: Tensor, valid: Tensor, p_hand: Tensor) -> Tensor:
        """Direction tokens (B, 5) as the estimator makes them.

        To the median of the rest, or else to the hand, where known.
        """
        by_hand = ~cloud.rest_known
        goal = torch.where(by_hand[:, None], p_hand, masked_median(rest, valid))
        known = torch.isfinite(goal).all(1)[:, None]
        sigma = goal.new_tensor(DIRECTION_SIGMA)
        token = direction_token(torch.where(known, goal, 0.0), cloud.centre, cloud.R, by_hand, sigma, self._torch_rng)
        return torch.where(known, token, 0.0)


def _weights(clouds: RenderedClouds, negative_share: float) -> NDArray[np.float32]:
    """Weight with which each cloud is drawn, (N,): categories and negatives by their shares."""
    weights = np.zeros(len(clouds), np.float32)
    kinds = [(~clouds.positive, negative_share)]
    for k, category in enumerate(Category):
        kinds.append((clouds.positive & (clouds.category == k), (1 - negative_share) * category.spec.training_share))
    for rows, share in kinds:
        weights[rows] = share / max(int(rows.sum()), 1)
    if not weights.any():
        raise AssetError("the file of rendered clouds is empty: take more images", code="asset.incomplete")
    return weights
