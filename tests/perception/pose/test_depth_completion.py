"""Depth completion from measured neighbours."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from toolee_robot.perception.pose.depth_completion import RINGS, complete_depth

SIZE = 24


def block(rows: slice, columns: slice) -> torch.Tensor:
    mask = torch.zeros(1, SIZE, SIZE, dtype=torch.bool)
    mask[:, rows, columns] = True
    return mask


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


def test_the_rim_of_a_slanting_face_continues_it() -> None:
    rows = torch.arange(SIZE, dtype=torch.float32)
    plane = (0.6 + 0.001 * rows)[None, None].expand(1, SIZE, SIZE)
    guess = complete_depth(plane, block(slice(6, 18), slice(6, 18)), block(slice(4, 20), slice(4, 20)))
    made = guess > 0
    assert int(made.sum()) == 16**2 - 12**2
    # Two pixels beyond the last known one a mean of neighbours lags by their slope.
    assert float((guess - plane)[made].abs().max()) < 0.0025


def test_an_outline_belongs_to_what_is_in_front() -> None:
    depth = torch.full((1, SIZE, SIZE), 1.2)
    depth[:, :, :10] = 0.6
    gap = block(slice(0, SIZE), slice(10, 11))
    torch.testing.assert_close(complete_depth(depth, ~gap, gap)[0, :, 10], torch.full((SIZE,), 0.6))


def test_far_from_everything_measured_nothing_is_completed() -> None:
    depth = torch.full((1, SIZE, SIZE), 0.7)
    guess = complete_depth(depth, block(slice(0, SIZE), slice(0, 2)), torch.ones(1, SIZE, SIZE, dtype=torch.bool))
    reached = torch.nonzero((guess[0] > 0).any(0))[:, 0]
    assert reached.tolist() == list(range(2, 2 + RINGS))
    assert not bool(complete_depth(depth, torch.zeros_like(guess, dtype=torch.bool), guess >= 0).any())
