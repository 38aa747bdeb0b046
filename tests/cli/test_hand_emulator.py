"""`toolee emulate hand`: the path of its port, and what is told to happen."""

from __future__ import annotations

import contextlib
import io
import os
import socket
import threading
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.cli.app import EXIT_USER, run
from toolee_robot.devices.hands.ability import AbilityLine
from toolee_robot.devices.hands.inspire import ModbusLine, SerialLine
from toolee_robot.errors import NoAnswerError, UserError
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands.inspire import InspireEmulator
from toolee_robot.sim_backend.hands.kit import LineFault, happen


def test_a_driver_finds_it_at_the_path_that_it_prints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(ours))
    link, angles = tmp_path / "hand", []

    def drive() -> None:
        while not link.exists():
            pass
        with contextlib.closing(SerialLine(str(link), 3)) as line:
            angles.append(line.read(1546, 2))
        os.write(theirs, b"\nnonsense\nshow\nunplug\n")
        os.close(theirs)

    driver = threading.Thread(target=drive)
    driver.start()
    assert run(["emulate", "hand", "inspire", "--hand-id", "3", "--link", str(link)]) == 0
    driver.join()
    said = capsys.readouterr()
    assert said.out.startswith("/dev/")
    assert "nonsense" in said.err
    assert "index 1000" in said.err
    assert angles == [(1000).to_bytes(2, "little")]
    assert not link.is_symlink()


def test_the_ability_hand_answers_at_its_address_as_delivered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(ours))
    link, positions = tmp_path / "hand", []

    def drive() -> None:
        while not link.exists():
            pass
        with contextlib.closing(AbilityLine(str(link), 0x50, HostClock())) as line:
            positions.append(line.find()[1].positions)
        os.write(theirs, b"heat index 75\npads off\nheat\nunplug\n")
        os.close(theirs)

    driver = threading.Thread(target=drive)
    driver.start()
    assert run(["emulate", "hand", "ability", "--handle", "55", "--link", str(link)]) == 0
    driver.join()
    said = capsys.readouterr()
    assert "Ability Hand" in said.err
    assert "'heat' cannot happen" in said.err
    assert "heat DEGREES" in said.err
    np.testing.assert_array_equal(positions, [(0.0,) * 6])


def test_the_inspire_hand_on_tcp_answers_where_it_is_told_to_listen(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(ours))
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    angles: list[bytes] = []

    def drive() -> None:
        while not angles:
            with contextlib.suppress(NoAnswerError), contextlib.closing(ModbusLine(f"tcp://{address}", 3)) as line:
                angles.append(line.read(1546, 2))
        os.write(theirs, b"echo\nunplug\n")
        os.close(theirs)

    driver = threading.Thread(target=drive)
    driver.start()
    assert run(["emulate", "hand", "inspire", "--hand-id", "3", "--tcp", address]) == 0
    driver.join()
    said = capsys.readouterr()
    assert said.out == f"tcp://{address}\n"
    assert "Modbus-TCP" in said.err
    assert "'echo' cannot happen" in said.err
    assert angles == [(1000).to_bytes(2, "big")]


@pytest.mark.parametrize(
    "options",
    [
        ["--tcp", "6000"],
        ["--tcp", "0.0.0.0:6000"],
        ["--tcp", "127.0.0.1:0", "--link", "hand"],
        ["--hand-id", "0"],
        ["--handle", "1200"],
        ["--link", "/no/such/folder/hand"],
    ],
)
def test_options_that_make_no_sense(options: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("unplug\n"))
    assert run(["emulate", "hand", "inspire", *options]) == EXIT_USER


def test_events() -> None:
    with InspireEmulator() as emulator:
        for event in (
            "handle 600",
            "slip 50",
            "heat index 75",
            "jam ring",
            "free ring",
            "mute",
            "unmute",
            "echo",
            "drop",
        ):
            assert "thumb_rotation 1000" in happen(emulator, event)
        assert emulator.faults.echo
        assert not emulator.faults.muted
        for fault in LineFault:
            happen(emulator, f"{fault} 2")
        assert emulator.faults.pending == 2 * len(LineFault)
        for nonsense in (
            "heat",
            "heat nose 3",
            "handle",
            "handle x",
            "mute 3",
            "garbage x",
            "jam ring 3",
            "boo",
            "boo ring",
        ):
            with raises(UserError, "user.hand_event"):
                happen(emulator, nonsense)
        assert happen(emulator, "unplug") == "unplugged"


@pytest.mark.parametrize("handle", ["-1", "101"])
def test_a_handle_where_no_finger_gets(handle: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("unplug\n"))
    assert run(["emulate", "hand", "ability", "--handle", handle]) == EXIT_USER


def test_the_shadow_hand_is_behind_the_address_that_it_prints(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("show\nheat FFJ0 41\njam nose\nunplug\n"))
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    assert run(["emulate", "hand", "shadow", "--handle", "55", "--tcp", address]) == 0
    said = capsys.readouterr()
    assert said.out == f"ws://{address}\n"
    assert "FFJ3 0" in said.err
    assert "controllers off" in said.err


@pytest.mark.parametrize(
    ("hand", "options"),
    [("shadow", ["--link", "x"]), ("shadow", ["--hand-id", "3"]), ("shadow", ["--tcp", "127.0.0.1:70000"]),
     ("shadow", ["--tcp", "9090"]), ("shadow", ["--handle", "91"])],
)  # fmt: skip
def test_options_of_another_hand(hand: str, options: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("unplug\n"))
    assert run(["emulate", "hand", hand, *options]) == EXIT_USER
