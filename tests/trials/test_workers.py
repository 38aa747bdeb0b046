"""Jobs of trials side by side, on threads of this process; and runs that are interrupted or killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.trials.test_trials import PLAN, job
from toolee_robot.trials import load_plan, run_trials
from toolee_robot.trials.report import FIGURES
from toolee_robot.trials.results import RESULTS, Record, read_results

OF_THE_RUN = frozenset({"seconds", "stage_seconds", "run_folder"})
"""Figures of a job that are no outcome: times of this machine, and where its folder lies."""


def test_the_same_plan_has_the_same_results_anywhere(tmp_path: Path) -> None:
    here = run_trials(PLAN, tmp_path / "here", 1, str, job)
    there = run_trials(PLAN, tmp_path / "there", 2, str, job)
    assert [(r.trial, r.figures) for r in here] == [(r.trial, r.figures) for r in there]


def test_ctrl_c_loses_no_result_that_was_told(tmp_path: Path) -> None:
    told = []

    def tell(text: str) -> None:
        told.append(text)
        if len(told) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_trials(PLAN, tmp_path, 1, tell, job)
    assert len(read_results(PLAN, tmp_path)[0]) == 3
    assert len(run_trials(PLAN, tmp_path, 1, str, job)) == 6


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
