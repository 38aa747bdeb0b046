"""`toolee hammer --view`: a browser beside a job that runs is told stages, prompts and motions as they come."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from tests.viewer.browser import CHROMIUM, Browser, browser
from toolee_robot.viewer.run_page import WORDS

_MAIN = "from toolee_robot.cli import main; main()"
PANEL = 900
"""Column at which the panel may begin."""


def _picture(seen: Browser) -> NDArray[np.int64]:
    """What is beside the panel."""
    return np.asarray(Image.open(io.BytesIO(seen.view.screenshot())).convert("RGB")).astype(int)[:, :PANEL]


def _address(job: subprocess.Popen[str]) -> str:
    assert job.stderr is not None
    for line in job.stderr:
        if found := re.search(r"http://[\d.:]+", line):
            return found[0]
    raise AssertionError("no address was told")


@pytest.mark.nightly
@pytest.mark.sim
@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine")
def test_the_browser_follows_a_job(tmp_path: Path) -> None:
    """From the handover on, while it runs. Its person answers at once: prompts are in test_run_page.py."""
    command = [sys.executable, "-c", _MAIN, "hammer", "--seed", "100", "--view", "--json", "--out", str(tmp_path)]
    with browser() as seen, subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True) as job:
        try:
            seen.view.goto(_address(job))
            seen.view.get_by_text(WORDS["handover"]).wait_for(timeout=300_000)
            before, messages = _picture(seen), seen.messages
            seen.view.get_by_text("strike 2:").first.wait_for(timeout=600_000)
            assert job.poll() is None, "the job still runs"
            moved = (abs(_picture(seen) - before).max(axis=-1) > 40).sum()
            headings = seen.headings
            said, _ = job.communicate(timeout=600.0)
        finally:
            job.kill()
    assert json.loads(said.splitlines()[-1])["success"]
    stages = [WORDS[stage] for stage in ("handover", "view", "perceive", "touch", "strike")]
    assert [heading for heading in headings if heading in stages] == stages
    assert seen.messages - messages > 100, "drawings"
    assert moved > 5_000, "pixels: the robot stands elsewhere"
