"""Poses as the network sees them, depth completed, and candidates pooled."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.examples import examples
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array
from toolee_robot.perception.pose import PoseEstimator, PoseResult, canonical
from toolee_robot.perception.pose.canonical import (
    PATCHES,
    POINTS,
    CanonicalCloud,
    canonicalize,
    canonicalize_one,
    complete_depth,
    farthest_points_first,
    with_rest,
    with_rest_one,
)
from toolee_robot.perception.pose.estimator import NEAREST
from toolee_robot.perception.pose.representation import DIM, decode, encode, mirrored
from toolee_robot.symmetry import SymmetryKind

seeds = st.integers(0, 2**31)


@given(seeds)
@examples(30)
def test_round_trip(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = torch.as_tensor(Rotation.random(5, rng=rng).as_matrix())
    p = torch.as_tensor(rng.normal(0, 0.05, (5, 3)))
    s = torch.as_tensor(rng.integers(0, 2, (5, 3)).astype(float))
    R2, p2, s2 = decode(encode(R, p, s))
    torch.testing.assert_close(R2, R, atol=1e-9, rtol=0)
    torch.testing.assert_close(p2, p)
    torch.testing.assert_close(s2, s)


@given(seeds, st.sampled_from(list(Category)))
@examples(40)
def test_the_mirrored_pose_is_what_the_mirrored_view_shows(seed: int, category: Category) -> None:
    """The plane that an EE mirrors in: y = 0, and z = 0 of wrenches."""
    rng = np.random.default_rng(seed)
    R, p = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 0.05, 3)
    plane = [1.0, 1.0, -1.0] if category.symmetry.kind is SymmetryKind.C2 else [1.0, -1.0, 1.0]
    half = rng.normal(0, 0.02, (50, 3))
    ee = np.concatenate([half, half * plane])
    seen = (ee @ R.T + p) * [-1.0, 1.0, 1.0]
    u = mirrored(encode(torch.as_tensor(R), torch.as_tensor(p), torch.zeros(3, dtype=torch.float64)))
    R_seen, p_seen, _ = (x.numpy() for x in decode(u))
    found = (seen - p_seen) @ R_seen
    turns = [np.ones(3)]
    if category.symmetry.kind is SymmetryKind.C2:
        assert tuple(category.symmetry.axis) == (1.0, 0.0, 0.0)
        turns.append(np.array([1.0, -1.0, -1.0]))
    distances = [np.linalg.norm(found[:, None] - ee * turn, axis=2).min(1).max() for turn in turns]
    assert min(distances) < 1e-9
    torch.testing.assert_close(mirrored(u), encode(torch.as_tensor(R), torch.as_tensor(p), torch.zeros(3).double()))


@given(seeds)
@examples(30)
def test_any_vector_decodes_to_a_rotation_that_keeps_the_action_axis(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = torch.as_tensor(rng.normal(size=(4, DIM)))
    u[1] = 0.0
    u[2, 3:6] = 2.5 * u[2, :3]  # second column along the first
    R, _, _ = decode(u)
    torch.testing.assert_close(R @ R.mT, torch.eye(3, dtype=R.dtype).expand(4, 3, 3), atol=1e-9, rtol=0)
    assert bool((torch.linalg.det(R) > 0).all())
    torch.testing.assert_close(R[0, :, 2], u[0, :3] / u[0, :3].norm())


@given(seeds, st.integers(1, 40), st.integers(1, 12))
@examples(30)
def test_farthest_points_come_first_and_none_is_lost(seed: int, different: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    # Repeated points, as of a cloud with too few; marks travel along.
    points = rng.normal(size=(2, different, 3)).astype(np.float32)[:, rng.integers(0, different, 40)]
    marked = torch.as_tensor(np.concatenate([points, np.arange(80.0, dtype=np.float32).reshape(2, 40, 1)], -1))
    ordered = farthest_points_first(marked, count)
    for before, after in zip(marked, ordered, strict=True):
        assert sorted(after[:, 3].tolist()) == before[:, 3].tolist()
        rows = before[(after[:, 3] - before[0, 3]).long()]
        torch.testing.assert_close(rows, after)
        first = after[:count, :3].double()
        everything = before[:, :3].double()
        torch.testing.assert_close(first[0].norm(), everything.norm(dim=1).max())
        for k in range(1, count):
            to_picked = torch.cdist(everything, first[:k]).amin(1)
            torch.testing.assert_close(to_picked.max(), torch.cdist(first[k : k + 1], first[:k]).amin())
    # A GPU takes another way to the same.
    on_gpu = canonical._farthest_of_batch(marked[..., :3], count)
    torch.testing.assert_close(marked.gather(1, on_gpu[..., None].expand(-1, -1, 4)), ordered[:, :count])


def test_canonical_cloud_ignores_background_and_distance() -> None:
    rng = np.random.default_rng(0)
    surface = rng.uniform(-0.02, 0.02, (300, 3)) + np.array([0.1, 0.0, 0.5])
    wall = rng.uniform(-0.05, 0.05, (120, 3)) + np.array([0.1, 0.0, 1.4])
    points = torch.as_tensor(np.concatenate([surface, wall]), dtype=torch.float32)[None]
    cloud = canonicalize(
        points, torch.ones(1, 420, dtype=torch.bool), torch.tensor([0.04]), torch.Generator().manual_seed(0)
    )
    assert cloud.points.shape == (1, POINTS, 3)
    assert int(cloud.count[0]) == 300
    assert float(cloud.points.norm(dim=-1).max()) < 0.05
    np.testing.assert_allclose(cloud.centre[0], [0.1, 0.0, 0.5], atol=0.004)
    back = cloud.points[0] @ cloud.R[0] + cloud.centre[0]
    nearest = (back[:, None] - points[0, None, :300]).norm(dim=-1).min(1).values
    assert float(nearest.max()) < 1e-5
    # The first points are spread out: each is farther from the others than a random choice would be.
    head = torch.cdist(cloud.points[0, :PATCHES], cloud.points[0, :PATCHES]) + torch.eye(PATCHES)
    assert float(head.min()) > 0.004


def test_completed_points_are_marked_and_do_not_move_the_centre() -> None:
    rng = np.random.default_rng(0)
    points = torch.as_tensor(rng.uniform(-0.02, 0.0, (200, 3)) + np.array([0.1, 0.0, 0.5]), dtype=torch.float32)[None]
    rim = torch.as_tensor(rng.uniform(0.005, 0.02, (100, 3)) + np.array([0.1, 0.0, 0.5]), dtype=torch.float32)[None]
    rim[0, 90:] = torch.tensor([0.1, 0.0, 0.9])
    everything = torch.ones(1, 200, dtype=torch.bool)
    alone = canonicalize(points, everything, torch.tensor([0.05]), torch.Generator().manual_seed(0))
    real = torch.arange(100)[None] >= 10
    cloud = canonicalize(
        points, everything, torch.tensor([0.05]), torch.Generator().manual_seed(0), completed=(rim, real)
    )
    torch.testing.assert_close(cloud.centre, alone.centre)
    assert int(cloud.count[0]) == int(alone.count[0]) == 200
    assert not bool(alone.completed.any())
    back = cloud.points[0] @ cloud.R[0] + cloud.centre[0]
    guessed = cloud.completed[0] > 0
    assert float((back[~guessed, None] - points[0]).norm(dim=-1).min(1).values.max()) < 1e-5
    # Neither the ones that are not real nor the ones far away.
    offset = (back[guessed, None] - rim[0, 10:90]).norm(dim=-1).min(1)
    assert float(offset.values.max()) < 1e-5
    assert len(torch.unique(offset.indices)) == 80


@pytest.mark.parametrize("seen", [50, 200, 700, 1500])
@pytest.mark.parametrize("guesses", [None, 0, 150])
@pytest.mark.parametrize("rest", [0, 15, 60, 900])
def test_one_cloud_becomes_what_it_becomes_in_a_batch(seen: int, guesses: int | None, rest: int) -> None:
    rng = np.random.default_rng(seen + rest)
    ee, background = np.array([0.1, -0.05, 0.5]), np.array([0.1, 0.0, 1.4])
    # A flat EE with a wall behind it, and a handle that begins beside it.
    points = rng.normal(0, [0.02, 0.01, 0.004], (seen, 3)) + ee
    points[::9] = rng.uniform(-0.1, 0.1, (len(points[::9]), 3)) + background
    guessed = None if guesses is None else rng.normal(0, 0.03, (guesses, 3)) + ee
    handle = rng.uniform(0.03, 0.8, (rest, 1)) * [0.6, 0.0, 0.8] + rng.normal(0, 0.003, (rest, 3)) + ee

    def pair(x: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        # The first of a batch of two draws what it draws alone.
        return torch.as_tensor(np.stack([x, x + 0.01]), dtype=torch.float32), torch.ones(2, len(x), dtype=torch.bool)

    radius = torch.tensor([0.04, 0.04])
    more = None if guessed is None else pair(guessed)
    batch = canonicalize(*pair(points), radius, torch.Generator().manual_seed(1), completed=more)
    batch = with_rest(batch, *pair(handle), torch.Generator().manual_seed(2))
    one = canonicalize_one(points, 0.04, torch.Generator().manual_seed(1), completed=guessed)
    one = with_rest_one(one, handle, torch.Generator().manual_seed(2))
    for field in fields(CanonicalCloud):
        of_one, of_batch = getattr(one, field.name), getattr(batch, field.name)[:1]
        torch.testing.assert_close(of_one, of_batch, atol=1e-6, rtol=0, msg=f"{field.name}: {{}}".format)


SIZE = 24


@examples(60)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.05, 0.95))
def test_a_completed_depth_lies_between_the_depths_that_are_known_and_only_where_it_is_wanted(
    seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    depth = torch.as_tensor(rng.uniform(0.3, 1.1, (2, SIZE, SIZE)), dtype=torch.float32)
    known = torch.as_tensor(rng.random((2, SIZE, SIZE)) < share)
    wanted = torch.as_tensor(rng.random((2, SIZE, SIZE)) < 0.5)
    completed = complete_depth(depth, known, wanted)
    assert not bool((completed > 0)[known | ~wanted].any())
    for image, depths, there in zip(completed, depth, known, strict=True):
        made = image[image > 0]
        if len(made):
            assert float(made.min()) >= float(depths[there].min()) - 1e-6
            assert float(made.max()) <= float(depths[there].max()) + 1e-6


def face_and_handle(distance: float) -> tuple[Array, Array]:
    """A hammer's face of 13 mm radius, turned away by 30 degrees, and its handle: points (N, 3), (M, 3) [m]."""
    rng = np.random.default_rng(0)
    radius, angle = 0.013 * np.sqrt(rng.uniform(size=400)), rng.uniform(0, 2 * np.pi, 400)
    face = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(400)])
    side = rng.uniform(-0.5 * np.pi, 0.5 * np.pi, 200)
    side = np.column_stack([0.013 * np.sin(side), -0.013 * np.cos(side), rng.uniform(0, 0.01, 200)])
    handle = np.column_stack([rng.uniform(-0.012, 0.012, 600), rng.uniform(0.02, 0.25, 600), np.full(600, 0.04)])
    c, s = np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))
    R = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    place = [0.02, 0.01, distance]
    return np.concatenate([face, side]) @ R.T + place, handle @ R.T + place


def estimate(distance: float) -> PoseResult:
    points, rest = face_and_handle(distance)
    return PoseEstimator.load().estimate(points, Category.HAMMER_HEAD, rest)


def test_a_cloud_nearer_than_those_of_the_training_is_trusted_as_one_at_their_edge() -> None:
    near, edge = estimate(0.30), estimate(NEAREST)
    np.testing.assert_allclose(near.X_camera_ee[:3, 3] - [0.02, 0.01, 0.30], [0, 0, 0], atol=0.01)
    assert near.confidence == pytest.approx(edge.confidence, abs=0.05)
    assert near.usable == edge.usable
