"""Determinism, variety and the split."""

from __future__ import annotations

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.tools import (
    NAIL_DRIVERS,
    TOOL_SPECS,
    Family,
    ToolKind,
    kinds_of,
    make_tool,
    split,
    test_seeds,
    train_seeds,
)

MASSES = {
    ToolKind.CLAW_HAMMER: 0.537,
    ToolKind.BALL_PEEN_HAMMER: 0.4993,
    ToolKind.CROSS_PEEN_HAMMER: 0.8324,
    ToolKind.CLUB_HAMMER: 0.4649,
    ToolKind.MALLET: 0.31,
    ToolKind.SLOTTED_SCREWDRIVER: 0.2032,
    ToolKind.PHILLIPS_SCREWDRIVER: 0.05472,
    ToolKind.NUT_DRIVER: 0.1698,
    ToolKind.OPEN_END_WRENCH: 0.0473,
    ToolKind.COMBINATION_WRENCH: 0.2496,
    ToolKind.ADJUSTABLE_WRENCH: 0.3915,
    ToolKind.BOX_WRENCH: 0.2519,
    ToolKind.SOCKET_WRENCH: 0.5733,
    ToolKind.HANGING_CLAW_HAMMER: 0.4095,
    ToolKind.WOODEN_MALLET: 0.1256,
    ToolKind.MEAT_TENDERISER: 0.1756,
    ToolKind.SLEDGE_HAMMER: 4.61,
    ToolKind.LONG_SLOTTED_SCREWDRIVER: 0.04216,
    ToolKind.LONG_PHILLIPS_SCREWDRIVER: 0.05246,
    ToolKind.PIPE_WRENCH: 1.093,
    ToolKind.MONKEY_WRENCH: 2.427,
    ToolKind.EYE_ADJUSTABLE_WRENCH: 0.4713,
}
"""Mass [kg] of the tool of seed 9 of every kind."""


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
    # 13 to 99 are left to custom tools: their numbers in data sets follow the first 13 kinds.
    later = range(100, 100 + len(TOOL_SPECS) - 13)
    assert [spec.number for spec in TOOL_SPECS.values()] == [*range(13), *later]
    for kind, spec in TOOL_SPECS.items():
        for seed in range(3):
            assert make_tool(kind, seed).categories == spec.end_effectors


@pytest.mark.parametrize("family", list(Family))
def test_the_first_kinds_of_a_family_make_two_thirds_of_its_draws(family: Family) -> None:
    specs = [TOOL_SPECS[kind] for kind in kinds_of(family)]
    first = sum(spec.draw_weight for spec in specs if spec.number < 13)
    assert first / sum(spec.draw_weight for spec in specs) == pytest.approx(2 / 3, abs=0.01)


def test_jobs_and_doctor_draw_from_the_same_hammers_as_ever() -> None:
    assert [str(kind) for kind in NAIL_DRIVERS] == [
        "claw_hammer", "ball_peen_hammer", "cross_peen_hammer", "club_hammer",
    ]  # fmt: skip


@pytest.mark.parametrize(("kind", "mass"), MASSES.items())
def test_a_tool_of_a_seed_stays_what_it_is(kind: ToolKind, mass: float) -> None:
    assert make_tool(kind, 9).mass == pytest.approx(mass, rel=1e-3)


def test_wrong_requests_are_named() -> None:
    with raises(UserError, code="user.seed_negative"):
        make_tool(ToolKind.MALLET, -1)
    with raises(UserError, code="user.category_missing"):
        make_tool(ToolKind.MALLET, 0).ee(Category.WRENCH_HEAD)
