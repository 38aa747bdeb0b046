"""A data set generated on Ray: a real cluster, started on this machine."""

from __future__ import annotations

import os
import re
import signal
import socket
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from tests.perception.folders import assert_same
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.perception.offline.dataset.spec import DatasetSpec, SceneJob
from toolee_robot.perception.offline.dataset.validate import validate
from toolee_robot.perception.offline.synthesis.generate import generate
from toolee_robot.runtime.ray_cluster import joined, on_ray

pytestmark = [pytest.mark.sim, pytest.mark.nightly]

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


@pytest.mark.usefixtures("cluster")
def test_errors_of_a_task_reach_the_user_as_what_they_are() -> None:
    with pytest.raises(AssetError, match=r"^scene 0 is broken$"):
        list(on_ray(_broken, SPEC.jobs()[:1], 2))
    with pytest.raises(
        TooleeError, match=r"^a Ray task failed: ZeroDivisionError: scene 0; run the same command again"
    ):
        list(on_ray(_wrong, SPEC.jobs()[:1], 2))


@pytest.mark.usefixtures("cluster")
def test_a_task_whose_process_dies_is_tried_again(tmp_path: Path) -> None:
    jobs = SPEC.jobs()[:2]
    done = list(on_ray(partial(_killed_once, tmp_path), jobs, 2))
    assert sorted(done, key=jobs.index) == jobs
    with pytest.raises(TooleeError, match=r"^a Ray task failed: WorkerCrashedError: .*it resumes"):
        list(on_ray(_killed, jobs, 2))
