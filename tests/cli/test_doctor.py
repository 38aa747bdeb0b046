"""`toolee doctor` as a person meets it: exit codes, JSON, and every finding with what to do."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.stand_in import stand_in
from toolee_robot.cli.app import run
from toolee_robot.doctor.machine import expected_robot
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.sim_backend.hands.inspire import InspireEmulator
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import load_station, sim_station
from toolee_robot.types import ArmModel

pytestmark = pytest.mark.usefixtures("networks_once")

_TOOLEE = [sys.executable, "-c", "from toolee_robot.cli import main; main()"]
_HOST, _SERIAL = "127.0.0.48", "20185500001"
_LAB = f"""
version: 3
arm: {{host: {_HOST}}}
calibration:
  measured_on: "2026-11-10"
  robot_serial: "{_SERIAL}"
  camera_serial: cam7
  residual: 0.001
  valid_days: null
"""
_WIRED = """
person: {door_closed_input: 0, door_open_input: 1, hold_to_run_input: 2, hold_to_run_released_input: null}
"""


@pytest.fixture(scope="module")
def robot() -> Iterator[ControllerProcess]:
    """A stand-in that somebody has set up at the pendant as the station file wants it."""
    payload = expected_robot(sim_station()).payload
    assert payload is not None
    with ControllerProcess(model="UR10", host=_HOST) as process:
        process.fault("payload", mass=payload.mass, cog=payload.center_of_mass.tolist())
        yield process


@pytest.fixture
def lab(tmp_path: Path) -> str:
    (tmp_path / "lab.yaml").write_text(_LAB)
    return str(tmp_path / "lab.yaml")


def _doctor(capsys: pytest.CaptureFixture[str], *args: str) -> tuple[int, dict[str, Any], str]:
    code = run(["doctor", *args, "--json"])
    captured = capsys.readouterr()
    return code, json.loads(captured.out.splitlines()[-1]), captured.err


@pytest.mark.sim(seconds=40)
def test_the_simulated_station_is_ready(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, record, said = _doctor(capsys, "--out", str(tmp_path / "runs"))
    assert code == 0, said
    assert "Ready for the job in simulation" in said
    assert record["worst"] in ("ok", "warn")
    assert {f["section"] for f in record["findings"]} == {
        "Simulated station (no --station)", "Calibration", "This computer",
    }  # fmt: skip
    assert not (tmp_path / "runs").exists(), "a look leaves nothing behind"


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
def test_a_robot_that_is_set_up_is_ready_for_slow_motions(
    robot: ControllerProcess, lab: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = robot.state()
    code, record, said = _doctor(capsys, "--robot-host", _HOST, "--station", lab)
    assert code == 0, said
    assert "Ready for slow, attended motions" in said
    assert record["robot_serial"] == _SERIAL
    assert record["arm_calibration"]["delta_a"] == pytest.approx([0.0] * 6, abs=1e-9)
    levels = {f["name"]: f["level"] for f in record["findings"]}
    assert (levels["hand"], levels["camera"], levels["calibration"]) == ("warn", "warn", "warn"), "nobody looked"
    assert levels["measured"] == "warn", "the file gives next to nothing, which a stand-in bears"
    assert levels["person"] == "warn", "no inputs in the file"
    assert (levels["TCP place"], levels["force"], levels["jogged point"]) == ("ok", "ok", "warn")
    assert (levels["base"], levels["mounting"]) == ("ok", "ok")
    after = robot.state()
    assert (after["q"], after["uploads"]) == (before["q"], before["uploads"])


@pytest.mark.sim(seconds=40)
def test_the_arms_own_kinematics_are_entered_beside_the_file(
    robot: ControllerProcess, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(f"version: 3\narm: {{host: {_HOST}}}{_WIRED}")
    robot.fault("kinematics", a=[0, 0.0012, 0, 0, 0, 0], d=[0.0] * 6)
    try:
        *_, said = _doctor(capsys, "--station", str(path), "--write")
        assert "the nominal UR10 is 1.2 mm off" in said
        assert f"written to {tmp_path / 'measured.yaml'}" in " ".join(said.split())
        calibration = load_station(path).arm.calibration
        assert calibration is not None
        assert calibration.delta_a == pytest.approx((0, 0.0012, 0, 0, 0, 0), abs=1e-6)
        assert path.read_text().endswith(_WIRED), "no program edits what a person wrote"
        assert "the calibrated UR10 is 0.0 mm off" in _doctor(capsys, "--station", str(path))[2]
    finally:
        robot.fault("kinematics", a=[0.0] * 6, d=[0.0] * 6)
    assert _doctor(capsys, "--write")[0] == 2, "of no robot"


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
@pytest.mark.usefixtures("robot")
def test_a_lab_without_a_calibration_moves_slowly_and_is_told_what_waits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """LAB.md, defect 4: no lab has the simulation's calibration; and the arm is brought up before the camera."""
    path = tmp_path / "lab.yaml"
    path.write_text(f"version: 3\narm: {{host: {_HOST}}}{_WIRED}")
    code, record, said = _doctor(capsys, "--station", str(path))
    assert code == 0, said
    found = {f["name"]: f for f in record["findings"]}
    assert (record["robot_serial"], found["calibration"]["level"]) == (_SERIAL, "warn")
    assert "no job" in found["calibration"]["message"]
    assert found["person"]["level"] == "warn"
    assert f"toolee doctor --station {path} --inputs" in found["person"]["remedy"]


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch, keyboard: int) -> int:
    """A person at a terminal, who sees what is printed and may type."""
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("TTY_INTERACTIVE", "0")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("LINES", "50")  # without it a dumb terminal has 80 columns
    return keyboard


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
@pytest.mark.parametrize(
    ("turned", "code", "expected_text"),
    [
        (False, 0, "0.0 mm from what the robot reports"),
        (True, 1, "half a turn"),
    ],
)
def test_at_a_terminal_the_jogged_point_is_asked_for_and_compared(
    robot: ControllerProcess,
    lab: str,
    capsys: pytest.CaptureFixture[str],
    terminal: int,
    turned: bool,
    code: int,
    expected_text: str,
) -> None:
    x, y, z = 1e3 * DhParameters.of(sim_station().arm.model).fk(np.array(robot.state()["q"]))[:3, 3]
    sign = -1.0 if turned else 1.0
    os.write(terminal, f"home\n{sign * x:.1f} {sign * y:.1f} {z:.1f}\n".encode())
    assert run(["doctor", "--station", lab]) == code
    said = capsys.readouterr().out
    assert said.count("Which X Y Z of the TCP does the Move screen show with the feature Base") == 1, said
    assert "give three numbers" in said, "home is none"
    assert expected_text in said


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
@pytest.mark.usefixtures("robot")
@pytest.mark.parametrize("answer", [b"\n", pytest.param(b"\x04", marks=pytest.mark.nightly)])
def test_who_skips_the_question_has_the_yellow_line(
    lab: str, capsys: pytest.CaptureFixture[str], terminal: int, answer: bytes
) -> None:
    os.write(terminal, answer)
    assert run(["doctor", "--station", lab]) == 0
    said = capsys.readouterr().out
    assert said.count("feature Base, in millimetres?") == 1, said
    assert "the frames were not compared with the pendant" in said


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
@pytest.mark.usefixtures("robot", "terminal")
@pytest.mark.parametrize(
    "args",
    [
        ["--json"],
        ["--jogged-point", "1", "2", "3"],
        ["--robot-host", "127.0.0.51"],
    ],
    ids=lambda args: args[0],
)
def test_nobody_is_asked_without_need(lab: str, capsys: pytest.CaptureFixture[str], args: list[str]) -> None:
    """Neither by a program, nor of a point that is given, nor of a robot that does not answer: it would wait."""
    run(["doctor", "--station", lab, *args])
    captured = capsys.readouterr()
    assert "in millimetres?" not in captured.out + captured.err


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
@pytest.mark.usefixtures("robot")
def test_nobody_is_asked_where_the_question_is_not_seen_or_there_is_no_keyboard(
    lab: str, capsys: pytest.CaptureFixture[str], keyboard: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert keyboard
    assert run(["doctor", "--station", lab]) == 0
    assert "in millimetres?" not in capsys.readouterr().out, "standard output is a pipe"
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setattr(sys, "stdin", io.StringIO("1 2 3\n"))
    assert run(["doctor", "--station", lab]) == 0
    assert "in millimetres?" not in capsys.readouterr().out


@pytest.mark.sim(seconds=40)
def test_a_robot_that_is_not_ready_is_exit_1_with_what_to_do(
    robot: ControllerProcess, lab: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    robot.fault("emergency_stop")
    try:
        code = run(["doctor", "--station", lab])
    finally:
        robot.fault("reset")
    said = capsys.readouterr().out
    assert code == 1
    assert "✗  safety              robot emergency stop" in said
    assert "release the emergency stop, and confirm it at the teach pendant" in said
    assert "Not ready:" in said


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
def test_a_tilted_base_is_looked_at_without_what_needs_an_upright_one(
    robot: ControllerProcess, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(f"version: 3\nframe: pendant_base\narm: {{host: {_HOST}, up: [0, 9.82, 0]}}\n")
    robot.fault("mounting", up=[0.0, 9.82, 0.0])
    try:
        code, record, said = _doctor(capsys, "--station", str(path))
    finally:
        robot.fault("mounting", up=[0.0, 0.0, 9.82])
    found = {f["name"]: f for f in record["findings"]}
    assert code == 0, said
    assert (found["base"]["level"], found["mounting"]["level"]) == ("warn", "ok")
    assert "tilted by 90.0°: no job" in found["base"]["message"]
    assert not {"handover", "views", "strike"} & set(found)


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
def test_no_robot_there_is_exit_1_and_the_rest_is_still_looked_at(capsys: pytest.CaptureFixture[str]) -> None:
    code, record, said = _doctor(capsys, "--robot-host", "127.0.0.49")
    assert code == 1
    assert record["worst"] == "fail"
    assert record["robot_serial"] is None
    assert "check the cable" in said
    assert {"strike", "networks", "schedule"} <= {f["name"] for f in record["findings"]}


def _obey(robot: ControllerProcess, prompt: str) -> None:
    """What a person does who is told so; the door is wired to the safeguard, too."""
    if "door" in prompt:
        robot.fault("door", opened="open" in prompt, index=0)
        robot.fault("digital_input", index=1, high="open" in prompt)
    else:
        robot.fault("digital_input", index=2, high="press" in prompt)


@pytest.mark.nightly
@pytest.mark.realtime
@pytest.mark.parametrize(
    ("model", "stuck", "door", "switch"),
    [
        (ArmModel.UR10, None, "every change was seen", "every change was seen"),
        (ArmModel.UR10E, None, "every change was seen", "every change was seen"),
        (ArmModel.UR10, 0, "both contacts of the door are high", "was seen"),
        (ArmModel.UR10E, 2, "was seen", "stays low: unplugged"),
    ],
)
def test_door_and_switch_are_seen_changing_and_nothing_moves(
    model: ArmModel, stuck: int | None, door: str, switch: str, tmp_path: Path
) -> None:
    path, host = tmp_path / "lab.yaml", "127.0.0.50"
    path.write_text(f"version: 3\narm: {{host: {host}, model: {model}}}{_WIRED}")
    payload = expected_robot(load_station(path)).payload
    assert payload is not None
    with stand_in(model, host, profile="harsh") as robot:
        robot.fault("payload", mass=payload.mass, cog=payload.center_of_mass.tolist())
        _obey(robot, "close the door")
        if stuck is not None:
            robot.fault("stuck_input", index=stuck)
        command = [*_TOOLEE, "doctor", "--station", str(path), "--inputs", "--json"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as doctor:
            assert doctor.stderr is not None
            assert doctor.stdout is not None
            said = []
            for line in doctor.stderr:
                said.append(line)
                if "(within" in line:
                    _obey(robot, line)
            record = json.loads(doctor.stdout.read().splitlines()[-1])
        trace = robot.trace(0)
    found = {f["name"]: f for f in record["findings"] if f["section"] == "Door and hold-to-run switch"}
    assert door in found["door"]["message"], "".join(said)
    assert switch in found["hold-to-run switch"]["message"], "".join(said)
    failed = [name for name, f in found.items() if f["level"] == "fail"]
    assert failed == [name for name, text in (("door", door), ("hold-to-run switch", switch)) if "seen" not in text]
    assert doctor.returncode == int(bool(failed)), "".join(said)
    assert np.ptp(trace.q_target, axis=0).max() < 1e-6, "nothing was commanded"


@pytest.mark.parametrize(
    ("args", "expected_text"),
    [
        (["--inputs"], "--inputs needs the controller's address"),
        (["--inputs", "--robot-host", "127.0.0.49"], "the station file has no `person`"),
        (["--jogged-point", "1", "2", "3"], "--jogged-point needs the controller's address"),
        (["--station", "none.yaml"], "none.yaml"),
        (["--arm", "ur-rtde"], "--arm"),
    ],
)
def test_bad_input_is_exit_2(args: list[str], expected_text: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = run(["doctor", *args])
    except SystemExit as stop:  # the parser's own
        code = int(str(stop.code))
    captured = capsys.readouterr()
    assert code == 2
    assert expected_text in captured.err.replace("\n", " ")
    assert not captured.out


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
def test_the_stations_own_hand_is_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (Path(__file__).parents[2] / "examples" / "inspire.yaml").read_text()
    with InspireEmulator() as emulator:
        (tmp_path / "lab.yaml").write_text(text.replace("/dev/ttyUSB0", emulator.port))
        options = ("--robot-host", "127.0.0.49", "--station", str(tmp_path / "lab.yaml"))
        found = [f for f in _doctor(capsys, *options)[1]["findings"] if f["name"] == "hand"]
    assert [f["level"] for f in found] == ["ok"], found
    found = [f for f in _doctor(capsys, *options)[1]["findings"] if f["name"] == "hand"]
    assert [f["level"] for f in found] == ["fail"], "unplugged"
    assert "hand.port" in found[0]["remedy"]
