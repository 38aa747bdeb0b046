"""`toolee sim hammer --view`: the page is there beside a job that runs, and the job ends as without it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import urllib.request
from pathlib import Path
from subprocess import PIPE

import pytest

_MAIN = "from toolee_robot.cli import main; main()"


def _address(job: subprocess.Popen[str]) -> str:
    assert job.stderr is not None
    for line in job.stderr:
        if found := re.search(r"http://[\d.:]+", line):
            return found[0]
    raise AssertionError("no address was told")


@pytest.mark.nightly
@pytest.mark.sim
def test_a_job_is_shown_while_it_runs(tmp_path: Path) -> None:
    options = ["--seed", "100", "--view", "--json", "--out", str(tmp_path)]
    command = [sys.executable, "-c", _MAIN, "sim", "hammer", *options]
    with subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True) as job:
        try:
            with urllib.request.urlopen(_address(job)) as served:
                assert b"<html" in served.read(2000)
            assert job.poll() is None, "the job still runs"
            said, _ = job.communicate(timeout=600.0)
        finally:
            job.kill()
    assert json.loads(said.splitlines()[-1])["success"]
