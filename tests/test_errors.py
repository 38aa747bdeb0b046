"""An error of the operating system is told once, in words."""

from __future__ import annotations

import ast
import errno
import os
import re
import socket
import termios
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from toolee_robot.devices.hands.ports import SerialPort, TcpPort
from toolee_robot.devices.hands.rosbridge import RosbridgeLine
from toolee_robot.devices.ur.protocols import tcp
from toolee_robot.errors import TooleeError, words_of
from toolee_robot.runtime.clock import HostClock
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.yaml_files import read_yaml
from toolee_robot.sim_backend.ur_controller.faults.fault_port import FaultClient

ROOT = Path(__file__).parents[1]


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def _caught(action: Callable[[], object]) -> BaseException:
    try:
        action()
    except (OSError, termios.error, KeyError, ValueError) as error:
        return error
    raise AssertionError("nothing was raised")


def _not_a_terminal() -> None:
    reading, writing = os.pipe()
    try:
        tty.setraw(reading)
    finally:
        os.close(reading)
        os.close(writing)


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (lambda: Path("/nowhere/x").read_text(), os.strerror(errno.ENOENT)),
        (lambda: serial.Serial("/dev/nowhere"), os.strerror(errno.ENOENT)),
        (_not_a_terminal, os.strerror(errno.ENOTTY)),
        (lambda: socket.create_connection(("127.0.0.1", _free_port())), os.strerror(errno.ECONNREFUSED)),
        (lambda: dict[str, int]()["rgb"], "'rgb' is missing"),
        (lambda: float("one"), "could not convert string to float: 'one'"),
    ],
    ids=["file", "serial port", "terminal", "address", "key", "number"],
)
def test_an_error_is_put_in_words(action: Callable[[], object], words: str) -> None:
    assert words_of(_caught(action)) == words


def test_a_number_inside_a_text_is_left_out_and_an_error_without_text_has_its_name() -> None:
    told = words_of(serial.SerialException("write failed: [Errno 5] Input/output error"))
    assert told == "write failed: Input/output error"
    assert words_of(EOFError()) == "EOFError"


@pytest.mark.parametrize(
    "action",
    [
        lambda folder: SerialPort(str(folder / "ttyUSB0"), 115200, 0.1),
        lambda _: TcpPort(f"tcp://127.0.0.1:{_free_port()}", 0.1),
        lambda _: RosbridgeLine(f"ws://127.0.0.1:{_free_port()}", HostClock()),
        lambda _: tcp.connect("127.0.0.1", _free_port(), time.monotonic() + 1.0),
        lambda _: FaultClient("127.0.0.1", _free_port(), 1.0),
        lambda folder: read_yaml(folder, "file"),
        lambda folder: write_atomic(folder / "nowhere" / "lab.yaml", b""),
    ],
    ids=["serial port", "hand over TCP", "rosbridge", "robot", "stand-in", "a folder is read", "no folder"],
)
def test_a_person_is_told_once_and_without_a_number(action: Callable[[Path], object], tmp_path: Path) -> None:
    with pytest.raises(TooleeError) as caught:
        action(tmp_path)
    message = str(caught.value)
    assert caught.value.__cause__ is not None
    assert "Errno" not in message
    assert message.count(words_of(caught.value.__cause__)) == 1
    assert message.count(str(tmp_path)) <= 1, "the place, too"


def _raw_messages(tree: ast.AST) -> Iterator[int]:
    """Lines on which a handler of OSError puts the error into a text by itself."""
    for handler in ast.walk(tree):
        if isinstance(handler, ast.ExceptHandler) and handler.type and "OSError" in ast.unparse(handler.type):
            for part in ast.walk(handler):
                text = ast.unparse(part.value) if isinstance(part, ast.FormattedValue) else ""
                if re.search(rf"\b{handler.name}\b", text) and "words_of" not in text:
                    yield int(vars(part)["lineno"])


def test_no_message_of_an_operating_systems_error_goes_round_the_helper() -> None:
    assert list(_raw_messages(ast.parse("try: x()\nexcept OSError as e: print(f'{e.strerror or e}')"))) == [2]
    assert list(_raw_messages(ast.parse("try: x()\nexcept (OSError, ValueError) as e: print(f'{e!r}')"))) == [2]
    rooms = ("toolee_robot", "sim_backend", "control", "perception", "scripts")
    files = [path for room in rooms for path in (ROOT / room).rglob("*.py")]
    assert len(files) > 300
    found = [
        f"{path.relative_to(ROOT)}:{line}" for path in files for line in _raw_messages(ast.parse(path.read_text()))
    ]
    assert found == []
