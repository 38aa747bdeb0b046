"""`toolee trials` that is killed with all its processes goes on where it stopped, with real jobs."""

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

from tests.trials.test_workers import OF_THE_RUN
from toolee_robot.trials import load_plan
from toolee_robot.trials.report import FIGURES
from toolee_robot.trials.results import RESULTS, Record, read_results

_MAIN = "from toolee_robot.cli import main; main()"
# Uncorrected jobs are the shortest: the first one of these misses the nail.
_PLAN = "name: A test\nfirst_seed: 101\ntrials: 2\narms: [no_correction]\nerrors: exact\n"


def _command(plan: Path, out: Path, *options: str) -> list[str]:
    return [sys.executable, "-c", _MAIN, "trials", str(plan), "--out", str(out), *options]


def _run(plan: Path, out: Path, *options: str) -> str:
    done = subprocess.run(_command(plan, out, *options), capture_output=True, text=True, timeout=600.0, check=True)
    return done.stdout


def _until(holds: Callable[[], object], what: str) -> None:
    end = time.monotonic() + 300.0
    while not holds():
        assert time.monotonic() < end, f"not: {what}"
        time.sleep(0.05)


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

    assert "1 of 2 trials are there already" in _run(file, out, "--jobs", "1")
    assert results.read_bytes().startswith(kept), "the first trial was not run again"
    folders = sorted(folder.name.split("-")[-1] for folder in runs.glob("[0-9]*"))
    assert (folders, finished.is_dir()) == (["seed101", "seed102"], True)

    _run(file, whole, "--jobs", "1")
    resumed, uninterrupted = read_results(plan, out)[0], read_results(plan, whole)[0]
    assert _same(resumed) == _same(uninterrupted)
    assert (out / FIGURES).read_text() == (whole / FIGURES).read_text()

    before = results.read_bytes()
    assert "2 of 2 trials are there already" in _run(file, out, "--jobs", "1")
    assert results.read_bytes() == before, "nothing is left to be run"
