"""Determinism, variety and the split."""

from __future__ import annotations

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.tools import (
    TOOL_SPECS,
    ToolKind,
    make_tool,
    split,
    test_seeds,
    train_seeds,
)


@pytest.mark.parametrize("kind", list(ToolKind))
def test_a_seed_always_gives_the_same_tool(kind: ToolKind) -> None:
    once, again = make_tool.__wrapped__(kind, 3), make_tool.__wrapped__(kind, 3)
    np.testing.assert_array_equal(once.mesh.vertices, again.mesh.vertices)
    np.testing.assert_array_equal(once.mesh.faces, again.mesh.faces)
    assert once.mass == again.mass
    assert [part.material for part in once.parts] == [part.material for part in again.parts]


@pytest.mark.parametrize("kind", list(ToolKind))
def test_every_seed_gives_another_shape(kind: ToolKind) -> None:
    shapes = np.array(
        [[*tool.mesh.extents, *tool.ees[0].X_tool_ee[:3, 3]] for tool in (make_tool(kind, s) for s in range(16))]
    )
    gaps = np.abs(shapes[:, None] - shapes[None]).max(-1) + np.eye(len(shapes))
    assert gaps.min() > 5e-4, "two seeds give nearly the same tool"


def test_split_holds_out_a_fifth_and_never_mixes() -> None:
    assert sum(split(s) == "test" for s in range(1000)) == 200
    assert len(set(train_seeds(80)) | set(test_seeds(20))) == 100
    assert all(split(s) == "train" for s in train_seeds(80))
    assert all(split(s) == "test" for s in test_seeds(20))


def test_every_kind_has_a_record_and_makes_tools_with_its_end_effectors() -> None:
    assert set(TOOL_SPECS) == set(ToolKind)
    assert [spec.number for spec in TOOL_SPECS.values()] == list(range(len(TOOL_SPECS)))
    for kind, spec in TOOL_SPECS.items():
        for seed in range(3):
            assert make_tool(kind, seed).categories == spec.end_effectors


def test_wrong_requests_are_named() -> None:
    with raises(UserError, code="user.seed_negative"):
        make_tool(ToolKind.MALLET, -1)
    with raises(UserError, code="user.category_missing"):
        make_tool(ToolKind.MALLET, 0).ee(Category.WRENCH_HEAD)
