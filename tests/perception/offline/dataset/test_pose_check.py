"""Poses of a data set against the points that are seen."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from toolee_robot.frames import Array
from toolee_robot.perception.offline.dataset.validate import pose_fault
from toolee_robot.types import CameraIntrinsics


def wrong(rod: Array, seen: Array, K: CameraIntrinsics, depth: float, moved: tuple[float, ...], thin: bool) -> bool:
    """Whether a rod's pose is called wrong that is moved from where its points were seen."""
    X = np.eye(4)
    X[:3, 3] = np.add((0.0, 0.0, depth), moved)
    return pose_fault(seen, np.ones(len(seen), np.bool_), X, cKDTree(rod), K, thin=thin) is not None


def rod_of(radius: float, half: float, rng: np.random.Generator) -> Array:
    """Points on a rod along y."""
    angle, along = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(-half, half, 6000)
    return np.column_stack([radius * np.cos(angle), along, radius * np.sin(angle)])


@pytest.mark.parametrize(
    ("moved", "sound"),
    [((0.0, 0.0, 0.0), True), ((0.04, 0.0, 0.0), False), ((0.0, 0.0, -0.03), False), ((0.0, 0.0, 0.03), False)],
)
def test_pixels_beside_a_thin_tool_are_no_fault_of_its_pose(moved: tuple[float, float, float], sound: bool) -> None:
    """A rod of 6 mm, 0.8 m away, of whose pixels three in five show the wall behind: the sensor's jitter."""
    K = CameraIntrinsics(366.0, 366.0, 256.0, 212.0, 512, 424)
    rng = np.random.default_rng(3)
    rod = rod_of(0.003, 0.05, rng)
    seen = np.column_stack([rng.uniform(-0.003, 0.003, 250), rng.uniform(-0.05, 0.05, 250), np.full(250, 0.797)])
    wall = rng.random(250) < 0.6
    seen[wall] *= 1.1 / seen[wall, 2:]
    assert wrong(rod, seen, K, 0.8, moved, thin=True) != sound


@pytest.mark.parametrize(
    ("behind", "moved", "sound"),
    [
        (0.57, (0.0, 0.0, 0.0), True),
        (0.57, (0.02, 0.0, 0.0), False),
        (0.57, (0.0, 0.0, -0.014), False),
        (0.57, (0.0, 0.0, 0.012), False),
        (0.57, (0.0, 0.0, 0.03), False),
        (0.35, (0.0, 0.0, 0.0), True),
        (0.35, (0.0, 0.0, -0.012), False),  # a third is on the tool still: that the others lie near tells it
    ],
)
def test_neither_are_they_of_a_long_screwdrivers_shaft(
    behind: float, moved: tuple[float, float, float], sound: bool
) -> None:
    """5 mm, 0.5 m away, so near that the mask is not thin; 3 mm of noise; a share of the points is behind it."""
    K = CameraIntrinsics(720.0, 720.0, 256.0, 212.0, 512, 424)
    rng = np.random.default_rng(5)
    shaft = rod_of(0.0025, 0.1, rng)
    seen = np.column_stack(
        [rng.uniform(-0.0025, 0.0025, 400), rng.uniform(-0.05, 0.05, 400), rng.normal(0.498, 0.003, 400)]
    )
    wall = rng.random(400) < behind
    seen[wall] *= rng.uniform(0.55, 0.6, 400)[wall, None] / seen[wall, 2:]
    assert wrong(shaft, seen, K, 0.5, moved, thin=False) != sound
