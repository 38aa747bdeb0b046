"""Where trials run does not matter: threads of this process and a Ray cluster keep the same contract.

Ray's part is nightly: a real cluster of one core, started on this machine.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from tests.errors import raises
from tests.trials.test_trials import PLAN, job
from toolee_robot.app.variant import Variant
from toolee_robot.errors import TooleeError
from toolee_robot.runtime.ray_cluster import on_ray
from toolee_robot.trials import TrialPlan, load_plan, run_trials
from toolee_robot.trials.report import FIGURES
from toolee_robot.trials.results import RESULTS, Record, read_results
from toolee_robot.trials.run import Workers, on_threads

OF_THE_RUN = frozenset({"seconds", "stage_seconds", "run_folder"})
"""Figures of a job that are no outcome: times of this machine, and where its folder lies."""


@pytest.fixture(scope="module")
def one_core() -> Iterator[None]:
    os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # listens on the loopback address alone
    import ray

    ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


@pytest.fixture(params=[on_threads, pytest.param(on_ray, marks=[pytest.mark.sim, pytest.mark.nightly])])
def workers(request: pytest.FixtureRequest) -> Workers:
    if request.param is on_ray:
        request.getfixturevalue("one_core")
    return request.param


def _square(x: int) -> int:
    return x * x


def _busy(folder: Path, x: int) -> int:
    """The number of calls that are under way."""
    mark = folder / str(x)
    mark.touch()
    time.sleep(0.05)
    count = len(list(folder.iterdir()))
    mark.unlink()
    return count


def _breaks(x: int) -> int:
    if x == 2:
        raise TooleeError(f"{x} broke", code="trials.crashed")
    return x


def test_every_item_has_its_result_once(workers: Workers) -> None:
    assert sorted(workers(_square, range(7), 2)) == [x * x for x in range(7)]
    assert list(workers(_square, [], 2)) == []
    assert sorted(workers(_square, range(3), None)) == [0, 1, 4]


def test_no_more_run_at_a_time_than_was_said(workers: Workers, tmp_path: Path) -> None:
    assert max(workers(partial(_busy, tmp_path), range(6), 1)) == 1


def test_an_error_of_the_project_comes_back_as_it_is_after_what_was_finished(workers: Workers) -> None:
    seen = []
    with raises(TooleeError, code="trials.crashed"), closing(workers(_breaks, range(4), 1)) as results:
        for result in results:
            seen.append(result)
    assert seen == [0, 1]


def test_the_same_plan_has_the_same_results_anywhere(workers: Workers, tmp_path: Path) -> None:
    here = run_trials(PLAN, tmp_path / "here", 1, str, job)
    there = run_trials(PLAN, tmp_path / "there", 2, str, job, workers)
    assert [(r.trial, r.figures) for r in here] == [(r.trial, r.figures) for r in there]


def test_ctrl_c_loses_no_result_that_was_told(workers: Workers, tmp_path: Path) -> None:
    told = []

    def tell(text: str) -> None:
        told.append(text)
        if len(told) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_trials(PLAN, tmp_path, 1, tell, job, workers)
    assert len(read_results(PLAN, tmp_path)[0]) == 3
    assert len(run_trials(PLAN, tmp_path, 1, str, job, workers)) == 6


def _dies_once(folder: Path, x: int) -> int:
    mark = folder / str(x)
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.usefixtures("one_core")
def test_what_a_lost_worker_was_doing_is_done_again(tmp_path: Path) -> None:
    assert list(on_ray(partial(_dies_once, tmp_path), [5], 1)) == [5]


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_on_ray_is_interrupted_as_any_other(tmp_path: Path, number: signal.Signals) -> None:
    code = (
        "import signal, time, sys; signal.signal(signal.SIGTERM, signal.default_int_handler)\n"
        "from toolee_robot.runtime.ray_cluster import on_ray\n"
        "try:\n"
        "    for x in on_ray(time.sleep, [0.2] * 1000, 1): print('one', flush=True)\n"
        "except KeyboardInterrupt: sys.exit(130)"
    )
    run = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert run.stdout is not None
    assert run.stdout.readline() == "one\n"
    run.send_signal(number)
    run.communicate(timeout=120.0)
    assert run.returncode == 130


@pytest.mark.sim
@pytest.mark.nightly
def test_a_job_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    """Or that of a lost worker would go on beside its repetition."""
    code = (
        "from pathlib import Path\nfrom toolee_robot.app.job import JobSpec\n"
        "from toolee_robot.app.variant import Variant\n"
        "from toolee_robot.app.simulated import Simulated, simulated_station\n"
        "from toolee_robot.trials.run import run_apart\n"
        "run_apart(JobSpec(Simulated(simulated_station(), 101), Variant.NO_CORRECTION), Path('runs'))"
    )
    owner = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path)
    _until(lambda: list((tmp_path / "runs").glob(".*.partial/recording.mcap")), "the job has begun")
    owner.kill()
    owner.wait()
    _until(lambda: list((tmp_path / "runs").glob("[0-9]*/summary.json")), "the job has ended")
    (summary,) = (tmp_path / "runs").glob("[0-9]*/summary.json")
    assert json.loads(summary.read_text())["outcome"] == "interrupted"


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_trials_that_are_interrupted_stop_the_arm_of_the_job_that_runs(tmp_path: Path, number: signal.Signals) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text("name: A test\nfirst_seed: 101\ntrials: 2\narms: [full]\nerrors: exact\n")
    main = "from toolee_robot.cli import main; main()"
    command = [sys.executable, "-c", main, "trials", str(plan), "--out", str(tmp_path / "out"), "--jobs", "1"]
    run = subprocess.Popen(command, start_new_session=True)
    jobs = tmp_path / "out" / "runs" / "full"
    _until(lambda: list(jobs.glob(".*.partial/recording.mcap")), "the job has begun")
    run.send_signal(number)
    assert run.wait(timeout=30.0) == 130
    (summary,) = jobs.glob("[0-9]*/summary.json")
    assert json.loads(summary.read_text())["outcome"] == "interrupted"


def _until(condition: Callable[[], object], what: str) -> None:
    end = time.monotonic() + 300.0
    while not condition():
        assert time.monotonic() < end, f"not: {what}"
        time.sleep(0.2)


@pytest.mark.sim(seconds=120)
@pytest.mark.nightly
@pytest.mark.usefixtures("one_core")
def test_a_simulated_trial_has_the_same_outcome_on_ray(tmp_path: Path) -> None:
    """The job itself, in a process of the worker's: every figure that is no time of this machine's."""
    plan = TrialPlan("tiny", 101, 1, (Variant.NO_CORRECTION,), "exact")
    (here,) = run_trials(plan, tmp_path / "here", 1, str)
    (there,) = run_trials(plan, tmp_path / "there", None, str, workers=on_ray)
    assert {k: v for k, v in here.figures.items() if k not in OF_THE_RUN} == {
        k: v for k, v in there.figures.items() if k not in OF_THE_RUN
    }
    assert here.command == there.command
    assert Path(there.figures["run_folder"], "summary.json").is_file()


_MAIN = "from toolee_robot.cli import main; main()"
# Uncorrected jobs are the shortest: the first one of these misses the nail.
_PLAN = "name: A test\nfirst_seed: 101\ntrials: 2\narms: [no_correction]\nerrors: exact\n"


def _command(plan: Path, out: Path, *options: str) -> list[str]:
    return [sys.executable, "-c", _MAIN, "trials", str(plan), "--out", str(out), *options]


def _run(plan: Path, out: Path, *options: str) -> str:
    done = subprocess.run(_command(plan, out, *options), capture_output=True, text=True, timeout=600.0, check=True)
    return done.stdout


def _same(records: list[Record]) -> list[object]:
    return [(r.trial, r.command, {k: v for k, v in r.figures.items() if k not in OF_THE_RUN}) for r in records]


@pytest.mark.sim
@pytest.mark.nightly
def test_a_killed_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    """Killed with its job in the middle of the second trial, and with a line that was being written."""
    file, out, whole = tmp_path / "plan.yaml", tmp_path / "killed", tmp_path / "whole"
    file.write_text(_PLAN)
    plan = load_plan(file)
    results, runs = out / RESULTS, out / "runs" / "no_correction"
    run = subprocess.Popen(_command(file, out, "--jobs", "1"), start_new_session=True, stdout=subprocess.DEVNULL)
    try:
        _until(lambda: list(runs.glob(".*-seed102.partial/recording.mcap")), "the second job has begun")
    finally:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
    (finished,) = runs.glob("[0-9]*")
    kept = results.read_bytes()
    assert kept.count(b"\n") == 2, "the plan and the first trial"
    with results.open("ab") as torn:
        torn.write(kept.splitlines()[1][:1000])

    assert "0 of 1 flush" in _run(file, out, "--report-only")
    assert json.loads((out / FIGURES).read_text())["finished"] == 1

    assert "1 of 2 trials are already done" in _run(file, out, "--jobs", "1")
    assert results.read_bytes().startswith(kept), "the first trial was not run again"
    folders = sorted(folder.name.split("-")[-1] for folder in runs.glob("[0-9]*"))
    assert (folders, finished.is_dir()) == (["seed101", "seed102"], True)

    _run(file, whole, "--jobs", "1")
    resumed, uninterrupted = read_results(plan, out)[0], read_results(plan, whole)[0]
    assert _same(resumed) == _same(uninterrupted)
    assert (out / FIGURES).read_text() == (whole / FIGURES).read_text()

    before = results.read_bytes()
    assert "2 of 2 trials are already done" in _run(file, out, "--jobs", "1")
    assert results.read_bytes() == before, "nothing is left to be run"
