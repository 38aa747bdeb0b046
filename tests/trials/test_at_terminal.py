"""A command at a pseudo-terminal, and a person who reads it and answers."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from toolee_robot.cli.app import run
from toolee_robot.runtime.clock import readable
from toolee_robot.trials import load_plan
from toolee_robot.trials.results import Happened, read_results

_CONTROL = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]|\r")


class Terminal:
    """Runs a Python program as the leader of its own terminal, so that Ctrl-C reaches it and its children."""

    def __init__(self, code: str, *args: str) -> None:
        self.text, self._read = "", 0
        self.pid, self._fd = pty.fork()
        if self.pid == 0:
            os.execve(sys.executable, [sys.executable, "-c", code, *args], {**os.environ, "COLUMNS": "200"})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._fd)
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)

    def wait_for(self, words: Sequence[str], timeout: float = 120.0) -> str:
        """Read until something is shown that was not there at the last call."""
        end = time.monotonic() + timeout
        while True:
            unread = self.text[self._read :]
            found = [(unread.find(word), word) for word in words if word in unread]
            if found:
                at, word = min(found)
                self._read += at + len(word)
                return word
            assert time.monotonic() < end, f"none of {words} came; the terminal shows:\n{self.text}"
            assert self._more(1.0), f"it ended without {words}; the terminal shows:\n{self.text}"

    def answer(self, line: str) -> None:
        """Type a line."""
        os.write(self._fd, line.encode() if line.endswith("\x03") else f"{line}\n".encode())

    def until_end(self, answers: Mapping[str, str], timeout: float = 120.0) -> int:
        """Answer questions until the command ends."""
        end = time.monotonic() + timeout
        while True:
            unread = self.text[self._read :]
            found = [(unread.find(question), question) for question in answers if question in unread]
            if found:
                at, question = min(found)
                self._read += at + len(question)
                self.answer(answers[question])
                end = time.monotonic() + timeout
            elif not self._more(1.0):
                break
            assert time.monotonic() < end, f"it asks nothing and does not end; the terminal shows:\n{self.text}"
        _, status = os.waitpid(self.pid, 0)
        self.pid = 0
        return os.waitstatus_to_exitcode(status)

    def _more(self, timeout: float) -> bool:
        """Read what comes; False where the command has ended."""
        if not readable([self._fd], timeout):
            return True
        try:
            data = os.read(self._fd, 65536)
        except OSError:  # the other end is closed
            return False
        self.text += _CONTROL.sub("", data.decode(errors="replace"))
        return bool(data)


MAIN = "from toolee_robot.cli import main; main()"
CHEAP = (
    """
import sys, time
import toolee_robot.app.job as app
from toolee_robot.runtime.clock import readable

class Result:
    def __init__(self, interrupted):
        nail = {"name": "nail", "measured_protrusion_mm": None if interrupted else 0.3}
        self.figures = {
            "success": not interrupted, "outcome": "interrupted" if interrupted else "flush", "reason": "for a test",
            "strikes": 3, "tool": "a hammer", "nails": [nail], "stage_seconds": {}, "run_folder": None,
        }

def run_job(spec, out, observer):
    print("job: at the terminal", sys.stdin.isatty(), sys.stderr.isatty())
    try:
        print("job: moving?", flush=True)
        while not readable([sys.stdin.fileno()], 0.1):
            pass  # a signal that came just before a read would wait for its end
        return Result(interrupted=sys.stdin.readline() != "go\\n")
    except KeyboardInterrupt:
        time.sleep(1.0)  # an arm takes its time to stop
        print("job: the arm stands still")
        return Result(interrupted=True)

app.run_job = run_job
"""
    + MAIN
)
"""The command with a stand-in for the job: it asks at the terminal, and stops its arm on Ctrl-C."""
LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
ANSWERS = {"continue later?": "r", "in mm,": "0.3", "does it lean": "n", "slip in the hand?": "n", "repeat it?": "y"}


def written(folder: Path, **fields: object) -> Path:
    path = folder / "plan.yaml"
    plan = {"name": "two", "first_seed": 1, "trials": 2, "where": {"run": str(LAB)}, **fields}
    path.write_text(json.dumps(plan))
    return path


@pytest.mark.parametrize("by", ["the keyboard", pytest.param("SIGTERM", marks=pytest.mark.nightly)])
def test_ctrl_c_in_a_job_stops_the_job_alone_and_the_person_measures_it(tmp_path: Path, by: str) -> None:
    plan = written(tmp_path, trials=1)
    with Terminal(CHEAP, "trials", str(plan), "--out", str(tmp_path / "out")) as terminal:
        terminal.wait_for(["continue later?"])
        terminal.answer("r")
        terminal.wait_for(["moving?"])
        if by == "SIGTERM":
            os.kill(terminal.pid, signal.SIGTERM)
        else:
            terminal.answer("\x03")
        assert terminal.until_end({**ANSWERS, "in mm,": "9"}) == 0, terminal.text
    (record,), _ = read_results(load_plan(plan), tmp_path / "out")
    assert not record.success
    assert record.figures["tries"] == 1


@pytest.mark.nightly
def test_ctrl_c_at_a_question_stops_and_the_same_command_goes_on(tmp_path: Path) -> None:
    plan = written(tmp_path)
    with Terminal(CHEAP, "trials", str(plan), "--out", str(tmp_path / "out")) as terminal:
        terminal.wait_for(["continue later?"])
        terminal.answer("r")
        terminal.wait_for(["moving?"])
        terminal.answer("go")
        terminal.wait_for(["in mm,"])
        terminal.answer("\x03")
        assert terminal.until_end({}) == 130, terminal.text
    assert [event.what for event in read_results(load_plan(plan), tmp_path / "out")[1]][-1] is Happened.STOPPED
    with Terminal(CHEAP, "trials", str(plan), "--out", str(tmp_path / "out")) as terminal:
        assert terminal.wait_for(["in mm,", "continue later?"]) == "in mm,", "the job was done: only measure"
        terminal.answer("0.3")
        assert terminal.until_end({**ANSWERS, "moving?": "go"}) == 0, terminal.text
    assert len(read_results(load_plan(plan), tmp_path / "out")[0]) == 2


def test_without_a_terminal_or_with_several_jobs_it_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    command = ["trials", str(written(tmp_path)), "--out", str(tmp_path / "out")]
    for options, what in ([], "there is none"), (["--jobs", "2"], "one trial at a time"):
        assert run([*command, *options]) == 2
        assert what in " ".join(capsys.readouterr().err.split())


@pytest.mark.sim
@pytest.mark.nightly
def test_a_rehearsal_stands_in_for_the_robot(tmp_path: Path) -> None:
    """The job itself at the terminal, every device emulated; after a stop the person quits the job."""
    plan = written(
        tmp_path,
        trials=1,
        attended=True,
        where={"rehearse": str(LAB), "profile": "ideal"},
        nails=[
            {
                "name": "short", "diameter": 0.0022, "length": 0.025, "head_diameter": 0.006, "protrusion": 0.008,
                "pilot_hole_diameter": 0.0019,
            }
        ],
        woods={"white pine": 0.35},
    )  # fmt: skip
    with Terminal(MAIN, "trials", str(plan), "--out", str(tmp_path / "out")) as terminal:
        answers = {**ANSWERS, "quit?": "q"}
        assert terminal.until_end(answers, timeout=900.0) == 0, terminal.text
    assert "2.2 x 25 mm, head 6 mm, 8 mm over the wood, pilot hole 1.9 mm" in terminal.text
    (record,), _ = read_results(load_plan(plan), tmp_path / "out")
    assert record.figures["source"] == "rehearsal"
    assert record.success, "the person says so"
    assert Path(record.figures["run_folder"], "summary.json").is_file()
