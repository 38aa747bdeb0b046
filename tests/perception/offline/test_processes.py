"""Processes that share work: they end with their parent, keep the order, and pass errors on."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from tests.errors import raises
from tests.runtime.processes import alive
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.perception.offline.processes import ProcessMap

PARENT = """
import os, time
from toolee_robot.perception.offline.processes import WorkerPool

if __name__ == "__main__":
    with WorkerPool(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(600)
"""


@pytest.mark.nightly
def test_a_worker_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert alive(worker)
        parent.kill()
    deadline = time.monotonic() + 30
    while alive(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(worker)


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
