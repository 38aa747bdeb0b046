"""`toolee arm` at a stand-in: what its joints do, and who has to agree first."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from tests.errors import raises
from tests.examples import timed
from tests.slow_motion import assert_slow
from tests.stand_in import stand_in
from toolee_robot.cli.app import parse, run
from toolee_robot.cli.output import TerminalPerson
from toolee_robot.control import RobotModel
from toolee_robot.errors import PersonNearError, UserError
from toolee_robot.sim_backend.ur_controller.faults.fault_port import FaultClient, Trace
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.tasks.bring_up.slow_motions import ACCELERATION, SPEED
from toolee_robot.types import ArmModel

HOST = "127.0.0.35"
LAB = """# a busy machine
version: 3
supervisor: {data_cycles: 50, overruns: 50}
servo: {watchdog: 2, heartbeat_timeout: 1}
"""


@pytest.fixture(scope="module")
def robot() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST) as process:
        hand = RobotModel.of_station(sim_station()).description
        payload = hand.hand_payload(hand.hand_open)
        process.fault("payload", mass=payload.mass, cog=payload.center_of_mass.tolist())
        yield process


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    (tmp_path / "lab.yaml").write_text(LAB)
    return tmp_path / "lab.yaml"


def _arm(capsys: pytest.CaptureFixture[str], lab: Path, *words: str, host: str = HOST) -> tuple[int, dict[str, Any]]:
    code = run(["arm", *words, "--robot-host", host, "--station", str(lab), "--yes", "--json"])
    out = capsys.readouterr()
    return code, json.loads(out.out.splitlines()[-1]) if out.out else {"said": out.err}


@contextmanager
def _meanwhile(act: Callable[[FaultClient], None], host: str = HOST) -> Iterator[None]:
    """Do something to the robot from a thread and over a connection of its own."""
    client = FaultClient(host)
    thread = threading.Thread(target=act, args=(client,))
    thread.start()
    try:
        yield
    finally:
        thread.join()
        client.close()


def _wait_until_moved(client: FaultClient, by: float) -> None:
    begin, deadline = np.array(client.fault("state")["q"]), time.monotonic() + 30.0
    while np.abs(np.array(client.fault("state")["q"]) - begin).max() < by and time.monotonic() < deadline:
        time.sleep(0.02)


def _moved(
    robot: ControllerProcess, act: Callable[[], tuple[int, dict[str, Any]]]
) -> tuple[int, dict[str, Any], Trace]:
    last = int(robot.trace().ticks[-1])
    code, told = act()
    return code, told, robot.trace(last)


@timed
@pytest.mark.realtime
def test_a_jog_and_a_line_stay_under_the_caps_at_the_joints(
    robot: ControllerProcess, lab: Path, capsys: pytest.CaptureFixture[str], timed: bool
) -> None:
    before = np.array(robot.state()["q"])
    code, told, trace = _moved(robot, lambda: _arm(capsys, lab, "move", "--joint", "6", "--by", "0.15"))
    assert code == 0, told
    if timed:
        assert_slow(trace, 125.0)
    np.testing.assert_allclose(robot.state()["q"], before + np.array([0, 0, 0, 0, 0, 0.15]), atol=1e-3)
    code, after, trace = _moved(
        robot, lambda: _arm(capsys, lab, "move", "--along", "0.03", "0", "0.02", "--frame", "pendant_base")
    )
    assert code == 0, after
    if timed:
        assert_slow(trace, 125.0)
    for frame, way in (("pendant_base", [0.03, 0, 0.02]), ("base_link", [-0.03, 0, 0.02])):
        moved = np.subtract(after[f"flange_{frame}"], told[f"flange_{frame}"])
        np.testing.assert_allclose(moved, way, atol=1e-3)


@timed
@pytest.mark.realtime
def test_ctrl_c_stops_the_arm_on_its_path(
    robot: ControllerProcess, lab: Path, capsys: pytest.CaptureFixture[str], timed: bool
) -> None:
    before = np.array(robot.state()["q"])

    def interrupt_in_motion(client: FaultClient) -> None:
        _wait_until_moved(client, 0.03)
        os.kill(os.getpid(), signal.SIGINT)

    with _meanwhile(interrupt_in_motion):
        code, _, trace = _moved(robot, lambda: _arm(capsys, lab, "move", "--joint", "6", "--by", "-0.3"))
    assert code == 130
    if timed:
        assert_slow(trace, 125.0)
    moved = np.array(robot.state()["q"]) - before
    assert -0.2 < moved[5] < -0.02
    assert np.abs(moved[:5]).max() < 1e-3


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_touch_tells_where_it_met_something_and_goes_back(
    robot: ControllerProcess, lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = np.array(robot.state()["q"])

    def push_in_motion(client: FaultClient) -> None:
        _wait_until_moved(client, 0.005)
        client.fault("force", wrench=[0, 0, 20.0, 0, 0, 0], seconds=1.0)

    with _meanwhile(push_in_motion):
        code, told, trace = _moved(
            robot, lambda: _arm(capsys, lab, "touch", "--along", "0", "0", "-0.04", "--frame", "base_link")
        )
    assert code == 0, told
    assert_slow(trace, 125.0)
    assert told["contact"]
    assert 0.001 < told["travelled"] < 0.035
    np.testing.assert_allclose(told["flange_base_link"][:2], np.negative(told["flange_pendant_base"][:2]))
    np.testing.assert_allclose(robot.state()["q"], before, atol=1e-3)


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_touch_with_a_cb3s_force_ends_at_what_it_meets_and_not_in_the_air(
    lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its noise alone exceeds the configured 8 N every other second: threshold, window and speed follow the noise."""
    host = "127.0.0.36"
    way = ("touch", "--along", "0", "0", "-0.012", "--frame", "base_link")
    with stand_in(ArmModel.UR10, host, profile="harsh") as robot:
        model = RobotModel.of_station(sim_station()).description
        hand = model.hand_payload(model.hand_open)
        robot.fault("payload", mass=hand.mass, cog=hand.center_of_mass.tolist())
        code, told = _arm(capsys, lab, *way, host=host)
        assert (code, told) == (1, {"contact": False})

        def push_in_motion(client: FaultClient) -> None:
            _wait_until_moved(client, 0.005)
            client.fault("force", wrench=[0, 0, 20.0, 0, 0, 0], seconds=3.0)

        with _meanwhile(push_in_motion, host):
            code, told = _arm(capsys, lab, *way, host=host)
        assert (code, told["contact"]) == (0, True)
        assert told["force"] == pytest.approx(20.0, abs=6.0)


@pytest.mark.realtime
def test_freedrive_tells_where_the_arm_is_and_leaves_it_there(
    robot: ControllerProcess, lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = np.array(robot.state()["q"])
    code, told = _arm(capsys, lab, "freedrive", "--seconds", "0.5")
    assert code == 0, told
    np.testing.assert_allclose(told["q"], before, atol=5e-3)


@pytest.mark.parametrize(
    ("words", "expected_text"),
    [
        (["move", "--robot-host", "192.0.2.7", "--joint", "1", "--by", "0.1", "--yes"], "2.7 may be a real robot"),
        (["transfer", "--to", "home", "--robot-host", "192.0.2.7"], "--station"),
        (["transfer", "--to", "home", "--robot-host", HOST], "standard input"),
        (["move", "--robot-host", HOST, "--joint", "1", "--yes"], "--joint together with --by"),
        (["move", "--robot-host", HOST, "--along", "0", "0", "0.1", "--yes"], "--along together with --frame"),
        (["move", "--robot-host", HOST, "--yes"], "give one motion"),
        (
            ["move", "--robot-host", HOST, "--joint", "1", "--by", "0.1", "--max-speed", "0", "--yes"],
            "the speed limit is",
        ),
        (["freedrive", "--robot-host", HOST, "--yes"], "--seconds"),
        (["lag", "--robot-host", HOST, "--write", "--yes"], "--station"),
    ],
)
def test_what_nobody_attends_or_nobody_can_mean_is_exit_2(
    words: list[str], expected_text: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert run(["arm", *words]) == 2
    assert expected_text in capsys.readouterr().err


def test_the_caps_hold_unless_a_person_raises_them() -> None:
    command = vars(parse(["arm", "transfer", "--to", "home"]))
    assert (command["max_speed"], command["max_acceleration"]) == (SPEED, ACCELERATION)


def test_a_robots_station_file_that_leaves_out_what_is_measured_moves_nothing(
    lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Otherwise the simulated camera, nail and person would be taken for the lab's."""
    assert run(["arm", "transfer", "--to", "home", "--robot-host", "192.0.2.7", "--station", str(lab)]) == 2
    assert "camera.position" in capsys.readouterr().err


def test_a_persons_key_or_a_closed_terminal_takes_the_confirmation_back(keyboard: int) -> None:
    person = TerminalPerson(Console(file=io.StringIO()))
    assert not person.hold_to_run_held(), "nothing was confirmed yet"
    os.write(keyboard, b"\n")
    person.confirm("Move?")
    with person.attending():
        assert person.hold_to_run_held()
        os.write(keyboard, b"x")
        time.sleep(0.05)
        assert not person.hold_to_run_held()
        assert not person.hold_to_run_held()
    assert not person.hold_to_run_held()
    with person.attending():
        assert person.hold_to_run_held(), "the key belonged to the motion that it stopped"


@pytest.mark.parametrize("answer", [b"n\n", b"yes\n", b"\x04"])
def test_any_answer_but_an_empty_line_moves_nothing(keyboard: int, answer: bytes) -> None:
    person = TerminalPerson(Console(file=io.StringIO()))
    os.write(keyboard, answer)
    with raises(PersonNearError, says="not confirmed"):
        person.confirm("Move?")


def test_the_person_at_the_terminal_counts_as_in_reach_and_answers_no_question_of_a_job(keyboard: int) -> None:
    person = TerminalPerson(Console(file=io.StringIO()))
    assert person.zone_occupied()
    assert not any(ask("?", 1.0) for ask in (person.request_handover, person.release, person.confirm_swing))
    assert keyboard


def test_without_a_terminal_there_is_no_person(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    with raises(UserError, says="standard input is not a terminal"):
        TerminalPerson(Console(file=io.StringIO()))


def _accelerated(
    capsys: pytest.CaptureFixture[str], lab: Path, *words: str, host: str = HOST
) -> tuple[int, list[dict[str, Any]], list[float] | None]:
    """Exit code, trials and recommendation of `toolee arm acceleration`."""
    code, told = _arm(capsys, lab, "acceleration", *words, host=host)
    return code, told["trials"], told["recommended"]


@pytest.mark.nightly
@pytest.mark.realtime
def test_each_joint_is_turned_about_with_rising_accelerations_and_stands_where_it_was(
    robot: ControllerProcess, lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab.write_text(LAB + "arm: {acceleration: 3}\n")
    before, last = np.array(robot.state()["q"]), int(robot.trace().ticks[-1])
    code, trials, recommended = _accelerated(capsys, lab, "--joint", "1", "6", "--most", "5")
    assert code == 0, trials
    assert [(t["joint"], t["acceleration"], t["sign"]) for t in trials] == [
        (joint, acceleration, "") for joint in (1, 6) for acceleration in (2.0, 4.0, 5.0)
    ]
    assert recommended == [5.0, 3.0, 3.0, 3.0, 3.0, 5.0], "of the joints that were not tried the station file's"
    for t in trials:
        assert t["reached"] == pytest.approx(t["acceleration"], rel=0.25)
    q = robot.trace(last).q
    np.testing.assert_allclose(robot.state()["q"], before, atol=1e-3)
    assert np.abs(q - before).max(axis=0)[[1, 2, 3, 4]] == pytest.approx(0.0, abs=1e-3)
    for joint in (0, 5):
        assert q[:, joint].max() - before[joint] == pytest.approx(before[joint] - q[:, joint].min(), rel=0.2)


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_joint_ends_where_it_deviates_and_gets_what_it_bore_before(
    robot: ControllerProcess, lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab.write_text(
        "version: 3\nservo: {lag: 0.05}\nsupervisor: {data_cycles: 50, overruns: 50, tracking_error: 0.02}\n"
    )
    robot.fault("lag", seconds=0.2)
    try:
        code, trials, recommended = _accelerated(capsys, lab, "--joint", "6")
    finally:
        robot.fault("lag", seconds=0.0)
    assert code == 0
    assert "deviates" in trials[-1]["sign"]
    assert trials[-1]["acceleration"] < 15.0, "which the station permits"
    assert recommended is not None
    assert recommended[5] == trials[-2]["acceleration"]


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_stop_ends_all_joints_and_recommends_nothing_for_those_that_were_not_tried(
    robot: ControllerProcess, lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop_in_motion(client: FaultClient) -> None:
        _wait_until_moved(client, 0.01)
        client.fault("protective_stop")

    try:
        with _meanwhile(stop_in_motion):
            code, trials, recommended = _accelerated(capsys, lab, "--joint", "6", "5", "--most", "20")
    finally:
        robot.fault("unlock")
    assert (code, recommended) == (1, None)
    assert {t["joint"] for t in trials} == {6}
    assert "protective stop" in trials[-1]["sign"]
    assert not any(t["sign"] for t in trials[:-1])


def test_nothing_is_fast_without_a_door_that_tells_who_is_in_reach(
    lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["arm", "acceleration", "--robot-host", HOST, "--station", str(lab)]) == 2
    assert "`person`" in capsys.readouterr().err


@pytest.mark.nightly
@pytest.mark.realtime
def test_the_arm_is_fast_once_the_door_was_seen_to_change_and_stops_raising_near_the_robots_own_stop(
    lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    host = "127.0.0.37"
    wiring = "person: {door_closed_input: 0, door_open_input: 1, hold_to_run_input: 2, hold_to_run_released_input: 3}\n"
    lab.write_text(f"{LAB}arm: {{model: UR10e}}\n{wiring}")
    with stand_in(ArmModel.UR10E, host, profile="harsh") as robot:
        model = RobotModel.of_station(sim_station()).description
        hand = model.hand_payload(model.hand_open)
        robot.fault("payload", mass=hand.mass, cog=hand.center_of_mass.tolist())
        robot.fault("force", wrench=[0, 0, 0, 0, 0, 20.0])  # of 28 Nm about wrist 3, at which it stops

        def door(client: FaultClient, *, opened: bool) -> None:
            client.fault("door", opened=opened, index=0)
            client.fault("digital_input", index=1, high=opened)

        def switch(client: FaultClient, *, held: bool) -> None:
            client.fault("digital_input", index=2, high=held)
            client.fault("digital_input", index=3, high=not held)

        def leave(client: FaultClient, *, opens: bool) -> None:
            deadline = time.monotonic() + 30.0
            while client.fault("state")["program_state"] != "PLAYING" and time.monotonic() < deadline:
                time.sleep(0.1)
            time.sleep(3.0)  # it asks
            for opened in (True, False) if opens else (False,):
                door(client, opened=opened)
                time.sleep(0.5)
            for held in (True, False):
                switch(client, held=held)
                time.sleep(0.5)

        words = ["arm", "acceleration", "--robot-host", host, "--station", str(lab), "--joint", "6", "--json"]
        with FaultClient(host) as client:
            door(client, opened=False)
            switch(client, held=False)
        with _meanwhile(lambda client: leave(client, opens=False), host):
            assert run(words) == 1
        assert "nobody was seen within reach" in capsys.readouterr().out
        with _meanwhile(lambda client: leave(client, opens=True), host):
            assert run(words) == 1
        (trial,) = json.loads(capsys.readouterr().out.splitlines()[-1])["trials"]
        assert "ratio 0.7" in trial["sign"]
