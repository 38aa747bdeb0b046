"""`toolee emulate hand`: the path of its port, and what is told to happen."""

from __future__ import annotations

import io
import os
import socket
import threading
from collections.abc import Callable
from contextlib import closing, suppress
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


def _emulate(monkeypatch: pytest.MonkeyPatch, words: str, drive: Callable[[], object], events: bytes) -> None:
    """Run `toolee emulate hand WORDS` while a driver asks; then the events are typed."""
    ours, theirs = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(ours))

    def ask() -> None:
        drive()
        os.write(theirs, events)
        os.close(theirs)

    driver = threading.Thread(target=ask)
    driver.start()
    assert run(["emulate", "hand", *words.split()]) == 0
    driver.join()


def _appears(link: Path) -> str:
    while not link.exists():
        pass
    return str(link)


def test_a_driver_finds_it_at_the_path_that_it_prints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    link, angles = tmp_path / "hand", []

    def drive() -> None:
        with closing(SerialLine(_appears(link), 3)) as line:
            angles.append(line.read(1546, 2))

    _emulate(monkeypatch, f"inspire --hand-id 3 --link {link}", drive, b"\nnonsense\nshow\nunplug\n")
    said = capsys.readouterr()
    assert said.out.startswith("/dev/")
    assert "nonsense" in said.err
    assert "index 1000" in said.err
    assert angles == [(1000).to_bytes(2, "little")]
    assert not link.is_symlink()


def test_the_ability_hand_answers_at_its_address_as_delivered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    link, positions = tmp_path / "hand", []

    def drive() -> None:
        with closing(AbilityLine(_appears(link), 0x50, HostClock())) as line:
            positions.append(line.find()[1].positions)

    _emulate(monkeypatch, f"ability --handle 55 --link {link}", drive, b"heat index 75\npads off\nheat\nunplug\n")
    said = capsys.readouterr().err
    assert "'heat' cannot happen" in said
    assert "heat DEGREES" in said
    np.testing.assert_array_equal(positions, [(0.0,) * 6])


@pytest.fixture
def address() -> str:
    """Where nobody listens."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return f"127.0.0.1:{free.getsockname()[1]}"


def test_the_inspire_hand_on_tcp_answers_where_it_is_told_to_listen(
    address: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    angles: list[bytes] = []

    def drive() -> None:
        while not angles:
            with suppress(NoAnswerError), closing(ModbusLine(f"tcp://{address}", 3)) as line:
                angles.append(line.read(1546, 2))

    _emulate(monkeypatch, f"inspire --hand-id 3 --tcp {address}", drive, b"echo\nunplug\n")
    said = capsys.readouterr()
    assert said.out == f"tcp://{address}\n"
    assert "'echo' cannot happen" in said.err
    assert angles == [(1000).to_bytes(2, "big")]


def test_the_shadow_hand_is_behind_the_address_that_it_prints(
    address: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    events = b"show\nheat FFJ0 41\njam nose\nunplug\n"
    _emulate(monkeypatch, f"shadow --handle 55 --tcp {address}", lambda: None, events)
    said = capsys.readouterr()
    assert said.out == f"ws://{address}\n"
    assert "FFJ3 0" in said.err
    assert "controllers off" in said.err


@pytest.mark.parametrize(
    "words",
    [
        "inspire --tcp 6000", "inspire --tcp 0.0.0.0:6000", "inspire --tcp 127.0.0.1:0 --link hand",
        "inspire --hand-id 0", "inspire --handle 1200", "inspire --link /no/such/folder/hand", "ability --handle -1",
        "ability --handle 101", "shadow --link x", "shadow --hand-id 3", "shadow --tcp 127.0.0.1:70000",
        "shadow --tcp 9090", "shadow --handle 91",
    ],
)  # fmt: skip
def test_options_that_make_no_sense(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("unplug\n"))
    assert run(["emulate", "hand", *words.split()]) == EXIT_USER


def test_events() -> None:
    with InspireEmulator() as emulator:
        for event in [
            "handle 600",
            "slip 50",
            "heat index 75",
            "jam ring",
            "free ring",
            "mute",
            "unmute",
            "echo",
            "drop",
        ]:
            assert "thumb_rotation 1000" in happen(emulator, event)
        assert emulator.faults.echo
        assert not emulator.faults.muted
        for fault in LineFault:
            happen(emulator, f"{fault} 2")
        assert emulator.faults.pending == 2 * len(LineFault)
        for nonsense in [
            "heat",
            "heat nose 3",
            "handle",
            "handle x",
            "mute 3",
            "garbage x",
            "jam ring 3",
            "boo",
            "boo ring",
        ]:
            with raises(UserError, "user.hand_event"):
                happen(emulator, nonsense)
        assert happen(emulator, "unplug") == "unplugged"
