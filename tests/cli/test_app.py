"""The command line as a person meets it: bad input is answered with what to do, never with a traceback."""

from __future__ import annotations

import json
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pytest

from tests.examples import seldom
from toolee_robot.cli.app import command_paths, run
from toolee_robot.cli.jobs import SimHammer

pytestmark = pytest.mark.sim

_INTRINSICS = "365.5,365.5,254.9,205.4"


def _toolee(*args: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from toolee_robot.cli import main; main()", *args],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=folder,
    )


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """rgb.png and depth.png (millimetres) of an empty table, 512x424, and what is wrong in other ways."""
    cv2.imwrite(str(tmp_path / "rgb.png"), np.full((424, 512, 3), 128, np.uint8))
    cv2.imwrite(str(tmp_path / "depth.png"), np.full((424, 512), 800, np.uint16))
    cv2.imwrite(str(tmp_path / "small.png"), np.full((100, 100), 800, np.uint16))
    np.save(tmp_path / "nan.npy", np.full((424, 512), np.nan, np.float32))
    (tmp_path / "text.png").write_text("not an image")
    (tmp_path / "pose.txt").write_text("1 0 0 0  0 1 0 0  0 0 1 0.7")
    (tmp_path / "no_pose.txt").write_text("1 2 3")
    (tmp_path / "scene").mkdir()
    (tmp_path / "lab.yaml").write_text("work: {nail_diametre: 0.002}")
    (tmp_path / "plan.yaml").write_text("name: a plan\nfirst_seed: 1\ntrials: 2\n")
    return tmp_path


def _frame_args(
    rgb: str = "rgb.png", depth: str = "depth.png", scale: str = "0.001", k: str = _INTRINSICS
) -> list[str]:
    return ["estimate", "--rgb", rgb, "--depth", depth, "--depth-scale", scale, "--intrinsics", k]


@pytest.mark.parametrize(
    ("args", "expected_text"),
    [
        ([], "usage: toolee COMMAND"),
        (["hammer"], "did you mean `toolee sim hammer` or `toolee rehearse hammer` or `toolee run hammer`?"),
        (["sim", "hamer"], "did you mean `toolee sim hammer`?"),
        (["run"], "usage: toolee run COMMAND"),
        (["arm", "mvoe"], "did you mean `toolee arm move`?"),
        (["freedrive"], "did you mean `toolee arm freedrive`?"),
        (["no-such-thing"], "`toolee --help` lists the commands"),
        (["arm"], "usage: toolee arm COMMAND"),
        (["sim", "hammer", "--sed", "3"], "--seed"),
        (["sim", "hammer", "--seed", "three"], "--seed"),
        (["sim", "hammer", "--seed", "-1"], "--seed -1"),
        (["sim", "hammer", "--station", "none.yaml"], "none.yaml"),
        (["sim", "hammer", "--station", "lab.yaml"], "work.nail_diametre"),
        (["sim", "hammer", "--out", "rgb.png"], "--out"),
        (["sim", "hammer", "--variant", "paper"], "toolee train paper"),
        (["sim", "hammer", "--paper-weights", "scene"], "--paper-weights DIR together"),
        (["sim", "hammer", "--nail", "left"], "the station's nails are nail"),
        (["rehearse", "hammer"], "STATION"),
        (["rehearse", "hammer", "lab.yaml"], "lab.yaml"),
        (["run", "hammer", "lab.yaml", "--variant", "perfect_perception"], "invalid choice"),
        (["run", "hammer", "lab.yaml", "--seed", "3"], "--seed"),
        (["sim", "hammer", "--errors", "none.yaml"], "none.yaml"),
        (["trials", "none.yaml"], "none.yaml"),
        (["estimate"], "--rgb"),
        (["estimate", "--rgb", "rgb.png", "--depth", "depth.png"], "--depth-scale, --intrinsics"),
        (_frame_args(rgb="none.png"), "none.png does not exist"),
        (_frame_args(rgb="text.png"), "text.png is not a readable image"),
        (_frame_args(depth="small.png"), "register the depth"),
        (_frame_args(depth="nan.npy"), "no known distance"),
        (_frame_args(depth="rgb.png"), "one channel"),
        (_frame_args(scale="1"), "millimetres"),
        (_frame_args(scale="1e-6"), "depth scale"),
        (_frame_args(scale="-1"), "--depth-scale"),
        (_frame_args(k="365.5,365.5"), "four"),
        (_frame_args(k="a,b,c,d"), "four numbers"),
        (_frame_args(k="365.5,365.5,5000,205"), "far from the middle of 512 px"),
        ([*_frame_args(), "--hand-pose", "no_pose.txt"], "16"),
        (["estimate", "--bop", "nowhere"], "nowhere is not a folder"),
        (["estimate", "--bop", "scene"], "scene_camera.json"),
        (["estimate", "--bop", "scene", "--rgb", "rgb.png"], "leave --rgb out"),
    ],
)
def test_bad_input_is_exit_2_with_a_remedy(
    args: list[str],
    expected_text: str,
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(files)
    monkeypatch.setenv("COLUMNS", "200")
    before = sorted(files.rglob("*"))
    for words in (args, [*args, "--json"]):
        try:
            code = run(words)
        except SystemExit as stop:  # the parser's own
            code = int(str(stop.code))
        captured = capsys.readouterr()
        assert code == 2, captured
        assert expected_text in captured.err.replace("\n", " ") or (words != args and "usage" in expected_text)
        assert "Traceback" not in captured.err
        errors = [json.loads(line)["error"] for line in captured.out.splitlines()]
        assert len(errors) == len(words) - len(args), "standard output is for results and for one line with --json"
        assert all(error["code"].startswith("user") or error["code"] == "config" for error in errors)
    assert sorted(files.rglob("*")) == before, "nothing half-written"


def test_results_of_trials_do_not_go_into_a_file(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(files)
    assert run(["trials", "plan.yaml", "--out", "text.png", "--json"]) == 2
    assert "text.png" in json.loads(capsys.readouterr().out)["error"]["message"]
    assert (files / "text.png").read_text() == "not an image"


def test_a_screen_that_is_not_there_is_said_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.chdir(tmp_path)
    assert run(["sim", "hammer", "--gui"]) == 2
    assert "--gui" in capsys.readouterr().err


@pytest.mark.parametrize("command", seldom("run hammer", "sim hammer", "rehearse hammer", "estimate", "doctor"))
def test_help_is_quick_and_shows_how(command: str, tmp_path: Path) -> None:
    done = _toolee(*command.split(), "--help", folder=tmp_path)
    assert done.returncode == 0
    assert f"toolee {command}" in done.stdout
    assert "--json" in done.stdout
    assert not done.stderr


@pytest.mark.parametrize("command", [*command_paths()], ids=" ".join)
def test_options_that_are_refused_are_an_error_for_json_too(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        run([*command, "--no-such-option", "--json"])
    captured = capsys.readouterr()
    assert json.loads(captured.out)["error"]["code"] == "user"
    assert "toolee " + " ".join(command) in captured.err


@pytest.mark.parametrize(
    "words",
    ["camera record --seconds nan", "camera record --every nan", "rehearse hammer x.yaml "
     "--real-time-factor nan", "calibrate camera --bars-mm nan 1", "annotate x --port 99999999"],
)  # fmt: skip
def test_a_number_that_is_none_is_refused_before_anything_is_done(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    needed = {"camera record": ["--out", "x", "--station", "x.yaml"], "calibrate camera": ["--station", "x.yaml"]}
    assert run([*words.split(), *needed.get(" ".join(words.split()[:2]), []), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "user"
    assert not list(tmp_path.iterdir())


def test_every_command_is_one_line_of_its_groups_help_on_one_screen(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    groups = {path[0] for path in command_paths() if len(path) == 2}
    for words in ((), *((group,) for group in sorted(groups))):
        with pytest.raises(SystemExit):
            run([*words, "--help"])
        lines = capsys.readouterr().out.splitlines()
        assert all(len(line) <= 80 and "…" not in line for line in lines), words
        assert len(lines) <= 24, words
        for name in {path[len(words)] for path in command_paths() if path[: len(words)] == words}:
            assert sum(line.startswith(f"  {name} ") for line in lines) == 1, (words, name)


def test_a_line_end_of_a_docstring_breaks_no_help(capsys: pytest.CaptureFixture[str]) -> None:
    @dataclass(frozen=True)
    class Broken:
        """Do it. Exit code 0: done;
        2: bad input.

        Another paragraph.
        """

        place: str = ""
        """Where it is
        (in metres)."""

    from toolee_robot.cli import app

    with pytest.raises(SystemExit):
        app._parse_options(cast(type[app.Command], Broken), ("broken",), ["--help"])
    printed = capsys.readouterr().out
    assert "done; 2: bad input.\n\nAnother" in printed
    assert "Where it is (in metres)." in printed


def test_help_imports_no_command(tmp_path: Path) -> None:
    code = "import sys, toolee_robot.cli.app; print([m for m in ('tyro', 'numpy', 'rich') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.strip() == "[]"


@pytest.mark.nightly
def test_an_empty_scene_is_an_empty_list_and_exit_1(files: Path) -> None:
    done = _toolee(*_frame_args(), "--hand-pose", "pose.txt", "--json", folder=files)
    assert done.returncode == 1, done.stderr
    assert json.loads(done.stdout) == []
    assert "no tool found" in done.stderr
    assert "Traceback" not in done.stderr


def test_missing_weights_are_a_failed_job_that_names_the_file(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from toolee_robot.perception import weight_files

    monkeypatch.chdir(files)
    monkeypatch.setattr(weight_files, "WEIGHTS_DIR", files / "scene")
    assert run([*_frame_args(), "--json"]) == 1
    captured = capsys.readouterr()
    assert "scene/segmentation" in captured.err.replace("\n", "")
    assert "scene/segmentation" in json.loads(captured.out)["error"]["message"]


def test_a_package_that_is_not_installed_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _fail(monkeypatch, ModuleNotFoundError("No module named 'pybullet.utils'", name="pybullet.utils"))
    assert run(["sim", "hammer", "--json"]) == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out)["error"]["code"] == "user.missing_package"
    assert "pybullet.utils" in captured.err
    assert "python -m pip install -e ." in captured.err


@pytest.mark.parametrize(
    "bug", [ModuleNotFoundError("", name="toolee_robot.nowhere"), ConnectionResetError(104, "reset"), ValueError("no")]
)
def test_a_bug_is_raised_and_told_for_json(
    bug: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _fail(monkeypatch, bug)
    with pytest.raises(type(bug)):
        run(["sim", "hammer", "--json"])
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "internal"


def _fail(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def fail(_: SimHammer) -> int:
        raise error

    monkeypatch.setattr(SimHammer, "run", fail)


@pytest.mark.parametrize("delay", [0.02, 0.2, 0.5])
def test_ctrl_c_during_the_imports_is_no_traceback(delay: float, tmp_path: Path) -> None:
    program = "from toolee_robot.cli import main; print('begins', flush=True); main()"  # before it Python itself starts
    command = [sys.executable, "-c", program, "doctor"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begins\n"
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (130, "Interrupted.\n")


def test_an_interrupt_in_a_callback_is_not_lost() -> None:
    """Nothing can be raised from a weak reference's callback: Python says so, and goes on."""
    program = """
import os, signal, time, weakref
import toolee_robot.cli.app as app
from toolee_robot.cli import main

class Thing: pass

def run(args, start):
    start()
    try:
        thing = Thing()
        kept = weakref.ref(thing, lambda _: os.kill(os.getpid(), signal.SIGINT))
        del thing
        time.sleep(20.0)
    except KeyboardInterrupt:
        return 130
    return 0

app.run = run
main([])
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, ended.stderr) == (130, "")


def test_a_hangup_that_is_ignored_interrupts_nothing() -> None:
    """As under nohup."""
    program = """
import os, signal
import toolee_robot.cli.app as app
from toolee_robot.cli import main

def run(args, start):
    start()
    os.kill(os.getpid(), signal.SIGHUP)
    return 0

app.run = run
signal.signal(signal.SIGHUP, signal.SIG_IGN)
main([])
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize(("to", "code", "said"), [("> /dev/full", 1, "No space left on device"), (">&-", 0, "")])
def test_output_that_cannot_be_written_ends_nothing(to: str, code: int, said: str) -> None:
    program = "from toolee_robot.cli import main; main()"
    command = f"{shlex.quote(sys.executable)} -c {shlex.quote(program)} devices list {to}"
    ended = subprocess.run(command, shell=True, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == code, ended.stderr
    assert said in ended.stderr
    assert "Traceback" not in ended.stderr
