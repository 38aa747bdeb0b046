"""Numbers of tools in data sets, and what a pool is drawn from."""

from __future__ import annotations

import pickle
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.perception.offline.dataset.catalogue import (
    FIRST_KINDS,
    GENERATED,
    CustomToolRecord,
    CustomTools,
    generated_tools,
)
from toolee_robot.perception.offline.dataset.instances import object_id
from toolee_robot.tools import TOOL_SPECS

CUSTOM = range(1950, 15000)
"""Numbers that belong to custom tools; data sets of custom tools were written with them when there were 13 kinds."""


def test_custom_tools_keep_the_numbers_and_object_ids_of_data_sets_already_written() -> None:
    record = CustomToolRecord(
        "mine", "", (Category.HAMMER_HEAD,), (tuple(transform().ravel()),), ((-0.1, 0.1),) * 3, "wood", "rubber"
    )
    custom = CustomTools(Path(), (record, record))
    assert custom.numbers("test") == [1950, 1951]
    assert [object_id(number, 0) for number in custom.numbers("test")] == [7801, 7805]
    assert custom.name(1951) == "mine"


def test_no_generated_tool_has_a_number_of_the_custom_ones() -> None:
    numbers = GENERATED.numbers("train") + GENERATED.numbers("test")
    assert len(set(numbers)) == len(numbers) == 150 * len(TOOL_SPECS)
    assert not set(numbers) & set(CUSTOM)
    assert (GENERATED.name(0), GENERATED.name(1949)) == ("claw_hammer-0000", "socket_wrench-0149")
    assert GENERATED.name(15000) == "hanging_claw_hammer-0000"
    for number in (-1, CUSTOM[0], CUSTOM[-1], max(numbers) + 1):
        with raises(UserError, code="user"):
            GENERATED.name(number)


def test_data_sets_of_the_first_kinds_draw_the_tools_that_they_always_drew() -> None:
    first = generated_tools(FIRST_KINDS)
    pool = first.pool(np.random.default_rng(5), "train")
    assert pool == (453, 91, 41, 15, 773, 1010, 938, 1168, 991, 1745, 1636, 1825)
    with raises(UserError, code="user"):
        first.name(15000)
    assert pickle.loads(pickle.dumps(first)) is first


@pytest.mark.parametrize("split", ["train", "test"])
def test_pools_show_every_kind_and_mostly_the_common_ones(split: str) -> None:
    rng = np.random.default_rng(0)
    drawn = [number for _ in range(400) for number in GENERATED.pool(rng, split)]
    assert {GENERATED.split(number) for number in drawn} == {split}
    kinds = Counter(GENERATED.listed(number).about["kind"] for number in drawn)
    assert set(kinds) == set(map(str, TOOL_SPECS))
    later = sum(number >= CUSTOM.stop for number in drawn) / len(drawn)
    assert later == pytest.approx(1 / 3, abs=0.03)
