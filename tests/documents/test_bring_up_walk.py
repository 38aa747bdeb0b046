"""The bring-up of a robot, as its page has it: every command of it, at a terminal, on each model's harsh stand-in.

The files, the commands and their order are the page's. A person at a pseudo-terminal presses Enter where a command asks
for it, and a key where one says that any key ends it. What needs a camera, a hand or inputs is left out: the page says
so, too.
"""

from __future__ import annotations

import os
import pty
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.documents.blocks import ROOT, blocks
from tests.slow_motion import assert_slow
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.doctor.machine import expected_robot
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.runtime.clock import readable
from toolee_robot.sim_backend.ur_controller.faults.fault_port import FaultClient, Trace
from toolee_robot.station import load_lab_station
from toolee_robot.types import ArmModel

pytestmark = [pytest.mark.realtime, pytest.mark.nightly]

PAGE = ROOT / "docs" / "how-to" / "first_nail.md"
LAB = ROOT / "examples" / "lab.yaml"
TOOLEE = [sys.executable, "-c", "from toolee_robot.cli import main; main()"]
HOSTS = {ArmModel.UR10: "127.0.0.58", ArmModel.UR10E: "127.0.0.59"}
LEFT_OUT = ("--inputs", "toolee arm acceleration", "toolee run hammer", "toolee emulate ur", "python -m")
"""Of the commands: what needs more than a robot, and what is not of the walk."""
TIMEOUT = 300.0


def page_commands() -> list[str]:
    """The page's commands that need the robot alone, in its order."""
    lines = [line for path, text in blocks("bash") if path == PAGE for line in text.splitlines()]
    walk = [line for line in lines if line.startswith(("toolee doctor", "toolee arm", "pytest"))]
    return [line for line in walk if not any(words in line for words in LEFT_OUT)]


def lab_file(model: ArmModel) -> str:
    """The example of a lab with the page's slow values, for the arm that is tried, and patient with a busy machine."""
    data: dict[str, Any] = yaml.safe_load(LAB.read_text())
    (slow,) = (yaml.safe_load(text) for path, text in blocks("yaml") if path == PAGE and text.startswith("arm:"))
    for section, values in slow.items():
        data[section] = data.get(section, {}) | values
    data["arm"]["model"] = model.value
    data["supervisor"] |= {"data_cycles": 50, "overruns": 50}
    for later in ("servo", "calibration", "person"):
        del data[later]
    del data["camera"]["device"]
    return yaml.safe_dump(data)


@dataclass
class Robot:
    """A stand-in, started with the page's command, and how far its trace was read."""

    model: ArmModel
    host: str
    faults: FaultClient
    seen: int = -1

    def moved(self) -> Trace:
        """The trace since the last call."""
        trace = self.faults.trace(self.seen)
        self.seen = int(trace.ticks[-1])
        return trace


@pytest.fixture(scope="module", params=list(HOSTS), ids=[model.value for model in HOSTS])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    model, host = request.param, HOSTS[request.param]
    path = tmp_path_factory.mktemp("station") / "lab.yaml"
    path.write_text(lab_file(model))
    payload = expected_robot(load_lab_station(path)).payload
    assert payload is not None
    command = [*TOOLEE, "emulate", "ur", "--model", model.value, "--host", host, "--profile", "harsh"]
    command += ["--payload-kg", f"{payload.mass}", "--payload-cog", *map(str, payload.center_of_mass)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        while not (line := process.stdout.readline()).startswith("Ctrl-C ends it"):
            assert line, "the stand-in ended by itself"
        with FaultClient(host) as faults:
            yield Robot(model, host, faults)
        process.terminate()


def pendant_shows(robot: Robot) -> list[str]:
    """The place of the TCP, the flange, in the feature Base [mm]."""
    X = DhParameters.of(robot.model).fk(np.array(robot.faults.state()["q"]))
    return [f"{1e3 * x:.1f}" for x in X[:3, 3]]


def at_terminal(words: list[str], folder: Path, robot: Robot) -> tuple[int, str]:
    """Exit code and output of a command whose terminal answers as a person would; foam lies in the way of a touch."""
    master, slave = pty.openpty()
    begun = np.array(robot.faults.state()["q"])
    with subprocess.Popen(
        words, cwd=folder, stdin=slave, stdout=slave, stderr=slave, env={**os.environ, "COLUMNS": "200"}
    ) as process:
        os.close(slave)
        text, answered, deadline = "", 0, time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            if readable([master], 0.05):
                try:
                    text += os.read(master, 1 << 16).decode()
                except OSError:  # the other end is closed
                    break
            asked = len(re.findall(r"Enter: (?:yes|skip)", text))
            asked += "freedrive" in words and "joints, rad" in text  # any key ends it
            if asked > answered:
                answered = asked
                time.sleep(0.2)  # it reads what it asks
                os.write(master, b"\n")
            if "touch" in words and np.abs(np.array(robot.faults.state()["q"]) - begun).max() > 0.005:
                with suppress(ValueError):
                    words.remove("touch")  # once
                    robot.faults.fault("force", wrench=[0, 0, 25.0, 0, 0, 0], seconds=4.0)
        else:
            process.kill()
            pytest.fail(f"{words} did not end: {text}")
    os.close(master)
    return process.returncode, text


def test_every_step_of_the_page_works_and_is_slow(robot: Robot, tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text(lab_file(robot.model))
    commands = page_commands()
    assert [words for words in ("freedrive", "move", "lag", "pytest", "home", "transfer", "touch", "doctor")
            if not any(words in command for command in commands)] == []  # fmt: skip
    robot.moved()
    for command in commands:
        words = shlex.split(
            command.replace("192.168.1.10", robot.host).replace("-model UR10", f"-model {robot.model.value}")
        )
        if "--jogged-point" in words:
            words[-3:] = pendant_shows(robot)  # the page shows that of a UR10e
        if words[0] == "toolee":
            words = [*TOOLEE, *words[1:], "--robot-host", robot.host]
        else:
            words = [str(ROOT / word) if word.startswith("tests/") else word for word in words]
            words = [sys.executable, "-m", *words, "--rootdir", str(ROOT), "-c", str(ROOT / "pyproject.toml")]
        code, text = at_terminal(words, tmp_path, robot)
        print(f"$ {command}\n{text}")
        assert code == 0, f"{command}: {text}"
        assert_slow(robot.moved(), ARM_DATA[robot.model].rate)
    assert "lag:" in (tmp_path / "measured.yaml").read_text(), "`lag --write` has written what it measured"
