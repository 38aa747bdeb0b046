"""A new lab's first hour, as `docs/how-to/first_nail.md` has it: from an empty folder to a driven nail, at a terminal.

The devices are those of a rehearsal: the mount needs none, the camera is librealsense's software device, the robot a
controller stand-in. What is typed in is what `examples/lab.yaml` says of its cell.
"""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.stations.lab_camera import LAB, TOOLEE
from tests.trials.test_at_terminal import Terminal
from toolee_robot.doctor.machine import expected_robot
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import load_lab_station
from toolee_robot.stations.template import INTRINSICS, OFFERED, get, open_questions, put
from toolee_robot.types import ArmModel

HOST, PORT = "127.0.0.61", "8247"
"""Of the controller stand-in, and of the page of `toolee station show`."""
TIMEOUT = 900.0
"""Longest time without a question [s]: a rehearsed job asks nobody."""

SERVO = "servo: {gain: 1200, lookahead: 0.03, lag: 0.07}\n"
"""What `toolee arm lag` measures of the controller stand-in."""


class Person:
    """Runs commands at a terminal, prints how long each took, and reads what it says."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def runs(self, command: str, answers: Mapping[str, str] | None = None) -> str:
        """What a command says, which ends with exit code 0; `answers` by what the question contains."""
        began = time.monotonic()
        with Terminal(TOOLEE, *shlex.split(command)[1:]) as terminal:
            code = terminal.until_end(answers or {}, TIMEOUT)
            said = terminal.text
        self._took(command, began)
        assert code == 0, f"{command}: exit code {code}\n{said}"
        return " ".join(said.split())

    def looks_at(self, command: str) -> None:
        """Serve a page until Ctrl-C."""
        began = time.monotonic()
        with Terminal(TOOLEE, *shlex.split(command)[1:]) as terminal:
            terminal.wait_for(["http://127.0.0.1:"])
            terminal.answer("\x03")
            assert terminal.until_end({}) == 0, terminal.text
        self._took(command, began)

    def _took(self, command: str, began: float) -> None:
        took = time.monotonic() - began
        self.seconds += took
        print(f"{took:7.1f} s  {command}", flush=True)


def typed(said: dict[str, Any]) -> dict[str, str]:
    """What a person types, by the question's name as the terminal shows it; Enter where an answer is offered."""
    data: dict[str, Any] = {}
    answers = {}
    while open_ones := open_questions(data):
        name = open_ones[0].name
        value = get(said, name)
        put(data, name, value)
        text = " ".join(map(str, value)) if isinstance(value, list) else "none" if value is None else str(value)
        answers[f"  {name}  "] = "" if name in OFFERED else text
    return answers


def pendant_shows(robot: ControllerProcess) -> str:
    """X Y Z of the TCP on the pendant's Move screen, feature Base [mm]."""
    X = DhParameters.of(ArmModel.UR10).fk(np.array(robot.state()["q"]))
    return " ".join(f"{1e3 * x:.1f}" for x in X[:3, 3])


@pytest.mark.realtime
@pytest.mark.nightly
def test_from_an_empty_folder_to_a_driven_nail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyrealsense2", exc_type=ImportError)
    monkeypatch.chdir(tmp_path)
    person, said = Person(), yaml.safe_load(LAB.read_text())

    told = person.runs("toolee station new lab.yaml --ask", typed(said))
    assert "the camera reports 640x480, fx 383.20" in told
    assert "Still open" in told, "what the next commands measure"
    assert "behind the arm" not in told
    assert "then a rehearsal" in told
    written = yaml.safe_load(Path("lab.yaml").read_text())
    lens = {name: written["camera"].pop(name) for name in INTRINSICS}
    assert lens == pytest.approx({name: said["camera"].pop(name) for name in INTRINSICS}, abs=1e-3)
    assert written.pop("strike") == {"speed": 0.4, "deepest": 0.01}, "as it is offered"
    left_out = {"servo", "calibration", "strike"}
    del said["scene"]["obstacles"]
    assert written == {name: value for name, value in said.items() if name not in left_out}
    person.looks_at(f"toolee station show lab.yaml --port {PORT}")

    payload = expected_robot(load_lab_station(Path("lab.yaml"))).payload
    assert payload is not None
    with ControllerProcess(model="UR10", host=HOST) as robot:
        robot.fault("payload", mass=payload.mass, cog=payload.center_of_mass.tolist())
        told = person.runs(
            f"toolee doctor --station lab.yaml --robot-host {HOST}", {"in millimetres?": pendant_shows(robot)}
        )
    for line in ("✓ sides", "✓ range", "✓ strike", "✓ jogged point", "✓ hand", "! calibration none"):
        assert line in told, told
    assert "Ready for slow, attended motions" in told

    Path("rehearsal.yaml").write_text(Path("lab.yaml").read_text().replace("speed: 0.4", "speed: 1.2") + SERVO)
    told = person.runs("toolee calibrate camera --station rehearsal.yaml --rehearse --write")
    assert "Entered in rehearsal.measured.yaml" in told
    told = person.runs("toolee calibrate nail --station rehearsal.yaml --rehearse")
    assert "true errors" in told
    told = person.runs("toolee rehearse hammer rehearsal.yaml --seed 3 --real-time-factor 0.5")
    assert "the nail is flush" in told
    (run,) = Path("runs").iterdir()
    assert json.loads((run / "summary.json").read_text())["nail"] == "flush", "it truly is"
    print(f"{person.seconds:7.1f} s  in all")
    assert person.seconds < 900.0, "a quarter of an hour of the commands' time on two cores that do nothing else"
