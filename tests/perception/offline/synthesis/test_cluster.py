"""A data set generated on Ray: a real cluster, started on this machine."""

from __future__ import annotations

import itertools
import os
import re
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from tests.errors import raises
from tests.perception.folders import assert_same
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.perception.offline.dataset.spec import DatasetSpec, SceneJob
from toolee_robot.perception.offline.dataset.validate import validate
from toolee_robot.perception.offline.processes import ProcessMap
from toolee_robot.perception.offline.synthesis.generate import generate
from toolee_robot.runtime.ray_cluster import joined, on_ray

SPEC = DatasetSpec("hard", size=4, seed=12, test_share=0.5, scene_size=1)
_LISTENS = "0A"
_LOOPBACK = re.compile("(0{16}FFFF0000)?[0-9A-F]{6}7F:|0{24}01000000:")  # 127.x.y.z, in IPv6 too, and ::1


@pytest.fixture(autouse=True)
def _no_other_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """One that the process has joined already."""
    with joined():
        yield


def _listening() -> set[str]:
    """Sockets that others than this machine may connect to: address:port, as the kernel writes them."""
    tables = (Path("/proc/net", name).read_text().splitlines()[1:] for name in ("tcp", "tcp6"))
    entries = (line.split()[1:4] for table in tables for line in table)
    return {local for local, _, state in entries if state == _LISTENS and not _LOOPBACK.match(local)}


@pytest.mark.sim
@pytest.mark.nightly
def test_ray_gives_the_bytes_of_one_process_and_listens_to_nobody_else(tmp_path: Path) -> None:
    seen: list[int] = []
    before, opened = _listening(), set()

    def progress(done: int, _: int) -> None:
        seen.append(done)
        opened.update(_listening() - before)

    assert generate(SPEC, tmp_path / "here")
    assert generate(SPEC, tmp_path / "there", 2, progress, cluster="ray")
    assert not opened
    assert_same(tmp_path / "here", tmp_path / "there")
    assert seen == [0, 1, 2, 3, 4]
    assert validate(tmp_path / "there") == []


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_a_cluster_that_does_not_answer_is_said_at_once(
    scheme: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        monkeypatch.setenv("RAY_ADDRESS", f"{scheme}127.0.0.1:{nobody.getsockname()[1]}")
        begun = time.monotonic()
        with pytest.raises(UserError, match=r"no Ray cluster answers at RAY_ADDRESS=.*ray start --head"):
            generate(SPEC, tmp_path, cluster="ray")
    assert time.monotonic() - begun < 10


def _broken(job: SceneJob) -> SceneJob:
    raise AssetError(f"scene {job.first} is broken")


def _wrong(job: SceneJob) -> SceneJob:
    raise ZeroDivisionError(f"scene {job.first}")


def _killed_once(folder: Path, job: SceneJob) -> SceneJob:
    mark = folder / f"{job.split}{job.first}"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return job


def _killed(job: SceneJob) -> SceneJob:
    os.kill(os.getpid(), signal.SIGKILL)
    return job


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.usefixtures("cluster")
def test_errors_of_a_task_reach_the_user_as_what_they_are() -> None:
    with pytest.raises(AssetError, match=r"^scene 0 is broken$"):
        list(on_ray(_broken, SPEC.jobs()[:1], 2))
    with pytest.raises(
        TooleeError, match=r"^a Ray task failed: ZeroDivisionError: scene 0; run the same command again"
    ):
        list(on_ray(_wrong, SPEC.jobs()[:1], 2))


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.usefixtures("cluster")
def test_a_task_whose_process_dies_is_tried_again(tmp_path: Path) -> None:
    jobs = SPEC.jobs()[:2]
    done = list(on_ray(partial(_killed_once, tmp_path), jobs, 2))
    assert sorted(done, key=jobs.index) == jobs
    with pytest.raises(TooleeError, match=r"^a Ray task failed: WorkerCrashedError: .*it resumes"):
        list(on_ray(_killed, jobs, 2))


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
