"""Long commands that are interrupted or killed at random moments: nothing is lost, and nothing goes on running.

`pytest --nightly tests/test_kills.py` kills 200 times, in parts that `-n 12 --dist worksteal` does beside each other; a
few kills are part of every run. The commands begin in forks of a server that has imported all they need, so that the
kills meet their work and not their imports.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import pytest
import yaml

from toolee_robot.cli import main
from toolee_robot.errors import AssetError
from toolee_robot.perception.weight_files import SUMS as WEIGHT_SUMS
from toolee_robot.perception.weight_files import load_weights
from toolee_robot.recording import RECORDING
from toolee_robot.recording.reading import read_history
from toolee_robot.trials import load_plan
from toolee_robot.trials.report import FIGURES
from toolee_robot.trials.results import read_results

pytestmark = pytest.mark.sim(seconds=60)

EXAMPLES = Path(__file__).parents[1] / "examples"
SOFT = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
PATIENCE_S = 90.0
"""Within which an interrupted command has ended on a busy machine, and what it has started after a kill."""
WHOLE_S = 900.0
"""Within which one that is not interrupted has ended on such a machine."""
_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(
    [
        "toolee_robot.app.job",
        "toolee_robot.app.simulated",
        "toolee_robot.stations.simulated",
        "toolee_robot.perception.offline.synthesis.generate",
        "toolee_robot.perception.offline.research.tooleenet_training",
    ]
)


def _command(folder: Path, words: Sequence[str], begun: Connection) -> None:
    os.setsid()
    os.chdir(folder)
    for name, stream in (("stdout", 1), ("stderr", 2)):
        os.dup2(os.open(name, os.O_CREAT | os.O_TRUNC | os.O_WRONLY), stream)
    begun.send(True)
    main(words)


@contextmanager
def _started(folder: Path, words: Sequence[str]) -> Iterator[BaseProcess]:
    """A command that has begun in a folder; nothing runs there after the context."""
    told, begun = _SERVER.Pipe(duplex=False)
    process = _SERVER.Process(target=_command, args=(folder, words, begun))
    process.start()
    try:
        assert told.recv()
        yield process
    finally:
        for pid in _running(folder):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.join()


def _running(folder: Path, but_for: bytes = b"nothing") -> list[int]:
    """Processes that were started in a folder, in whatever session, but for those with a word in their command line."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal() and int(entry.name) != os.getpid():
            with suppress(OSError):
                inside = (entry / "cwd").readlink().is_relative_to(folder)
                if inside and but_for not in (entry / "cmdline").read_bytes():
                    found.append(int(entry.name))
    return found


def _until(holds: Callable[[], object], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end, what
        time.sleep(0.05)


@dataclass(frozen=True)
class Ended:
    """How a command has ended.

    Attributes:
        folder: Where it ran.
        code: Its exit code; negative: the signal that killed it.
        said: Standard error.
        record: The line of --json; None after a kill.
    """

    folder: Path
    code: int
    said: str
    record: dict[str, Any] | None


class Long(ABC):
    """A long command.

    Attributes:
        words: Its words.
        resumes: Whether the same command goes on where it stopped.
        codes: Exit codes when it was not interrupted.
        outlives: A word in the command line of what goes on after SIGKILL, on purpose.
        seconds: Time in which it is killed; None: as long as it takes.
    """

    words: tuple[str, ...]
    resumes = True
    codes: tuple[int, ...] = (0,)
    outlives = b"nothing"
    seconds: float | None = None

    @abstractmethod
    def prepare(self, folder: Path) -> None:
        """Put there what it reads."""

    @abstractmethod
    def check(self, ended: Ended) -> None:
        """Whether what it has left is whole, or can be told from what is."""

    @abstractmethod
    def result(self, folder: Path) -> object:
        """What is there at its end, whatever interrupted it."""

    def run(
        self, folder: Path, kill: signal.Signals | None = None, after: float = 0.0, everybody: bool = False
    ) -> Ended:
        """Run it, and kill it after a time: its own process alone, or all, as a terminal does."""
        with _started(folder, self.words) as process:
            if kill is not None:
                process.join(after)
                assert process.pid is not None
                if process.is_alive():  # it leads a session of its own
                    (os.killpg if everybody else os.kill)(process.pid, kill)
            process.join(WHOLE_S if kill is None else PATIENCE_S)
            assert not process.is_alive(), f"{kill!r} after {after:.2f} s did not end it"
            but_for = self.outlives if kill is signal.SIGKILL else b"nothing"
            _until(lambda: not _running(folder, but_for), f"{kill!r} after {after:.2f} s left processes")
            code = process.exitcode
        assert code is not None
        said, out = (folder / "stderr").read_text(), (folder / "stdout").read_text()
        told = f"{kill!r} after {after:.2f} s, everybody={everybody}: {code}\n{out}\n{said}"
        if kill is signal.SIGKILL and code == -signal.SIGKILL:
            ended = Ended(folder, code, said, None)
        else:
            assert code in (*self.codes, *((130,) if kill else ())), told
            assert "Traceback" not in said, told
            (line,) = [line for line in out.splitlines() if line.startswith("{")]
            ended = Ended(folder, code, said, json.loads(line))
        try:
            self.check(ended)
        except Exception as error:
            raise AssertionError(told) from error
        return ended


class Job(Long):
    """`toolee sim hammer`: the result of each job is kept, whenever the interrupt comes."""

    words: tuple[str, ...] = ("sim", "hammer", "--seed", "101", "--variant", "perfect_perception", "--errors", "exact",
             "--station", "short.yaml", "--out", "runs", "--json")  # fmt: skip
    resumes = False
    codes = 0, 1

    def prepare(self, folder: Path) -> None:
        (folder / "short.yaml").write_text("work: {nail_protrusion: 0.004}")

    def check(self, ended: Ended) -> None:
        runs = ended.folder / "runs"
        whole = sorted(runs.glob("[0-9]*")) if runs.is_dir() else []
        if ended.record is None:
            assert not whole, "a killed job's folder has another name"
            for recording in runs.glob(".*.partial/" + RECORDING):
                if "Grip" in ended.said:  # more than a second has been recorded
                    assert read_history(recording).metadata["seed"] == "101"
            return
        assert not list(runs.glob(".*.partial"))
        if "error" in ended.record:
            assert ended.code in (1, 130), "1: a device failed before, as a camera that is late on a busy machine"
            assert "Handover" not in ended.said, "a job that has begun has a result"
            assert not whole
            return
        (folder,) = whole
        assert ended.record["run_folder"] == f"runs/{folder.name}"
        summary = json.loads((folder / "summary.json").read_text())
        assert summary["outcome"] == ended.record["outcome"]
        assert (ended.code == 130) == (summary["outcome"] == "interrupted")
        assert read_history(folder / RECORDING).complete
        assert (folder / "picture.png").stat().st_size > 1000

    def result(self, folder: Path) -> object:
        return len(list((folder / "runs").iterdir()))


class Rehearsal(Job):
    """`toolee rehearse hammer`: driver, servo process and emulators end with it."""

    outlives = b"program_watch"
    """It asks the controller for up to ten minutes to end the program that a killed driver has left there."""
    seconds = 60.0
    """Of four minutes: until the nail is touched. The strikes are those of `Job`."""
    words = ("rehearse", "hammer", "lab.yaml", *Job.words[2:6], "--real-time-factor", "0.5", "--out", "runs", "--json")

    def prepare(self, folder: Path) -> None:
        said = yaml.safe_load((EXAMPLES / "lab.yaml").read_text())
        said["work"]["nail_protrusion"] = 0.004
        said["camera"]["device"]["driver"] = "orbbec"  # whose emulation needs no library of the system
        (folder / "lab.yaml").write_text(yaml.safe_dump(said | {"task": {"views": 1, "views_again": 1}}))


class Trials(Long):
    """`toolee trials`: no result is lost or had twice."""

    words = ("trials", "plan.yaml", "--out", "out", "--jobs", "2", "--json")

    def prepare(self, folder: Path) -> None:
        Job().prepare(folder)
        plan = {"name": "A", "first_seed": 101, "trials": 2, "arms": ["perfect_perception"], "errors": "exact"}
        (folder / "plan.yaml").write_text(yaml.safe_dump(plan | {"where": {"config": "short.yaml"}}))

    def check(self, ended: Ended) -> None:
        plan = load_plan(ended.folder / "plan.yaml")
        done = read_results(plan, ended.folder / "out")[0]
        assert ended.said.count("perfect_perception, seed 10") <= len(done), "what is told is on the disk"
        assert ended.code != 0 or len(done) == 2
        for record in done:
            assert (ended.folder / record.figures["run_folder"] / "summary.json").is_file()

    def result(self, folder: Path) -> object:
        figures = json.loads((folder / "out" / FIGURES).read_text())
        return {name: value for name, value in figures.items() if "second" not in name}


class DataSet(Long):
    """`toolee dataset generate`: the same bytes, however often it was killed."""

    words = ("dataset", "generate", "--config", "paper", "--size", "6", "--workers", "2", "--out", "out", "--json")

    def prepare(self, folder: Path) -> None: ...

    def check(self, ended: Ended) -> None:
        finished = (ended.folder / "out" / "SHA256SUMS").is_file()
        assert finished or ended.code != 0
        if finished:
            self.result(ended.folder)

    def result(self, folder: Path) -> object:
        from tests.perception.folders import unsound

        assert not unsound(folder / "out")
        return (folder / "out" / "SHA256SUMS").read_bytes()


class Training(Long):
    """`toolee train paper`: the same weights, however often it was killed."""

    words = ("train", "paper", "clouds.npz", "--out", "out", "--device", "cpu", "--config", "few.yaml", "--json")

    def prepare(self, folder: Path) -> None:
        from tests.perception.offline.research.test_tooleenet import stored_clouds

        stored_clouds(12).save(folder / "clouds.npz")
        few = {"batch": 4, "judged": 4, "draws": 2, "epochs": 4, "log_every": 1, "checkpoint_minutes": 0.001}
        (folder / "few.yaml").write_text(yaml.safe_dump(few))

    def check(self, ended: Ended) -> None:
        out = ended.folder / "out"
        if ended.code != -signal.SIGKILL:
            assert not list(out.glob(".*.part"))
        if (out / WEIGHT_SUMS).is_file():
            try:
                load_weights(out, "pose_paper")
            except AssetError:  # killed between two of its files, which is told; the checkpoint has the weights
                assert ended.code == -signal.SIGKILL

    def result(self, folder: Path) -> object:
        tensors, description = load_weights(folder / "out", "pose_paper")
        return {name: value.tolist() for name, value in tensors.items()}, description["report"]["steps"]


PARTS: dict[type[Long], int] = {Rehearsal: 2, Job: 12, Trials: 8, DataSet: 9, Training: 9}
"""Of the 200 kills; the commands that take longest come first."""
KILLS = 5
"""Of a part."""


@pytest.mark.nightly
@pytest.mark.parametrize("part", [f"{kind.__name__}-{i}" for kind, parts in PARTS.items() for i in range(parts)])
def test_kills_at_200_random_moments_lose_nothing_and_leave_nothing_running(part: str, tmp_path: Path) -> None:
    (kind,) = (kind for kind in PARTS if kind.__name__ == part.partition("-")[0])
    command, folder, began, whole = kind(), tmp_path / "whole", time.monotonic(), None
    if command.seconds is None:
        folder.mkdir()
        command.prepare(folder)
        assert command.run(folder).code in command.codes
        whole = command.result(folder)
    _kill(command, part, KILLS, command.seconds or time.monotonic() - began, tmp_path, whole)


@pytest.mark.nightly
@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGHUP])
def test_a_terminals_interrupt_while_the_jobs_of_trials_are_imported(kill: signal.Signals, tmp_path: Path) -> None:
    """It reaches the server of the jobs, too, which has imported nothing yet."""
    command = Trials()
    command.prepare(tmp_path)
    words = [sys.executable, "-c", "from toolee_robot.cli import main; main()", *command.words]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, cwd=tmp_path, start_new_session=True, stdout=pipe, stderr=pipe, text=True) as process:
        _until(lambda: len(_running(tmp_path)) > len(_running(tmp_path, b"forkserver")), "there is a server")
        os.killpg(process.pid, kill)
        told, said = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, json.loads(told)["error"]["code"]) == (130, "interrupted")
    assert [line for line in said.splitlines() if not line.startswith("A  plan")] == ["Interrupted."]
    assert not _running(tmp_path)


def _kill(command: Long, seed: str, kills: int, seconds: float, parent: Path, whole: object = None) -> None:
    """Kill a command at random moments of the seconds it takes; one that resumes goes on after each."""
    random_, folders = random.Random(seed), (parent / str(i) for i in count())

    def fresh() -> Path:
        folder = next(folders)
        folder.mkdir()
        command.prepare(folder)
        return folder

    folder, left = fresh(), kills
    while left:
        kill = random_.choice((*SOFT, signal.SIGKILL))
        code = command.run(folder, kill, random_.uniform(0.0, 1.05 * seconds), random_.random() < 0.5).code
        left -= code not in command.codes  # another one for each that came too late
        print(f"{seed}: {kill.name}, exit code {code}, {left} left")
        if code in command.codes:
            assert whole is None or command.result(folder) == whole
        if code in command.codes or not command.resumes:
            folder = fresh()
    if command.resumes:
        assert command.run(folder).code in command.codes
        assert whole is None or command.result(folder) == whole
