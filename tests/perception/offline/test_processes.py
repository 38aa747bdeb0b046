"""The map over processes that share work."""

from __future__ import annotations

import itertools
import os
from contextlib import closing

import pytest

from tests.errors import raises
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.perception.offline.processes import ProcessMap


def begin() -> list[int]:
    return [os.getpid()]


def ask(state: list[int], item: int) -> tuple[int, int]:
    state.append(item)
    if item == 100:
        raise AssetError("item 100 is broken")
    if item == 200:
        os._exit(9)
    return state[0], item


@pytest.mark.nightly
def test_a_process_map_keeps_the_order_and_the_errors_and_takes_from_endless_items() -> None:
    with ProcessMap(begin, 1) as alone:
        assert list(alone.map(ask, range(5))) == [(os.getpid(), k) for k in range(5)]
    with ProcessMap(begin, 2) as processes:
        with closing(processes.map(ask, itertools.count(-1000))) as endless:
            found = list(itertools.islice(endless, 20))
        assert [item for _, item in found] == list(range(-1000, -980))
        assert os.getpid() not in {pid for pid, _ in found}
        with pytest.raises(AssetError, match="item 100"):
            list(processes.map(ask, range(90, 110)))
        with raises(TooleeError, code="toolee.worker_died"):
            list(processes.map(ask, [200]))
    with raises(UserError, code="user.workers"):
        ProcessMap(begin, 0)
