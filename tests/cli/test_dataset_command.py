"""`toolee dataset` as a person meets it."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.data_set import main as draw
from toolee_robot.cli.app import run

pytestmark = pytest.mark.sim(seconds=20)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("made") / "paper"
    options = ["--config", "paper", "--size", "5", "--seed", "4", "--workers", "1"]
    assert run(["dataset", "generate", *options, "--out", str(root)]) == 0
    return root


@pytest.mark.nightly
def test_it_can_be_looked_at(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "pictures"
    draw([str(made), "--out", str(out), "--count", "3"])
    assert sorted(p.name for p in out.iterdir()) == ["montage_test.png", "montage_train.png"]
    for path in out.glob("*.png"):
        assert np.asarray(Image.open(path).convert("L")).std() > 10, f"{path.name} shows something"


def test_what_is_made_is_not_made_again_and_what_is_missing_tells_its_cost(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "paper"
    shutil.copytree(made, root)
    options = ["--config", "paper", "--size", "5", "--seed", "4", "--out", str(root), "--json"]
    assert run(["dataset", "generate", *options]) == 0
    line = json.loads(capsys.readouterr().out)
    assert line["made"] is False
    assert line["cost"] is None
    (root / "SHA256SUMS").unlink()
    shutil.rmtree(root / "train/000000")
    assert run(["dataset", "generate", *options]) == 0
    cost = json.loads(capsys.readouterr().out)["cost"]
    assert cost["examples"] == 4, "of five, one is in the test split"
    assert cost["per_second"] > 0
    assert cost["cpu_ms"] > 1
    assert cost["worker_mb"] > 50


@pytest.mark.nightly
def test_an_impatient_ctrl_c_ends_it_at_once(tmp_path: Path) -> None:
    """In a terminal it reaches the workers, too; waiting for them, the second one brought the pool to a standstill."""
    code = "from toolee_robot.cli import main\nif __name__ == '__main__': main()"
    (tmp_path / "run.py").write_text(code)
    options = ["--config", "paper", "--size", "2000", "--out", "data", "--workers", "2"]
    process = subprocess.Popen(
        [sys.executable, "run.py", "dataset", "generate", *options],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        assert process.stdout is not None
        assert "rendering: 0/2000" in process.stdout.readline()
        scenes = tmp_path / "data" / "train"
        deadline = time.monotonic() + 60.0
        while not any(scenes.iterdir()) and time.monotonic() < deadline:
            time.sleep(0.1)
        for _ in range(2):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            time.sleep(0.5)
        output, _ = process.communicate(timeout=20)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode in (130, -signal.SIGINT), output  # the second one strikes as it ends
    assert "Traceback" not in output


@pytest.mark.parametrize(
    ("arguments", "expected_text"),
    [
        (["generate", "--config", "hard", "--size", "0", "--out", "x"], "--size 0"),
        (["generate", "--config", "hard", "--size", "2", "--out", "x", "--workers", "0"], "--workers 0"),
        (["generate", "--config", "hard", "--size", "2", "--out", "x", "--test-share", "2"], "--test-share"),
        (["generate", "--config", "hard", "--size", "2", "--out", "file"], "file"),
        pytest.param(
            ["generate", "--config", "hard", "--size", "2", "--out", "x", "--device", "cuda"],
            "choose cpu",
            marks=pytest.mark.skipif("__import__('warp').is_cuda_available()", reason="there is a GPU"),
        ),
    ],
)
def test_misuse_says_what_to_do(
    arguments: list[str],
    expected_text: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    assert run(["dataset", *arguments]) == 2
    assert expected_text in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
