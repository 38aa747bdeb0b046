"""The serial ports that a person is told of when the hand's is not there."""

from __future__ import annotations

from pathlib import Path

import pytest
from serial.tools.list_ports import comports

from tests.errors import raises
from toolee_robot.devices.hands import ports
from toolee_robot.errors import ConfigError

DEVICES = sorted(found.device for found in comports())


def test_names_that_stay_the_same_are_told_before_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [tmp_path / "usb-FTDI_RS485-if00-port0", tmp_path / "usb-Prolific_2303-if00-port0"]
    for name in reversed(names):
        name.touch()
    monkeypatch.setattr(ports, "_BY_ID", tmp_path)
    assert ports.serial_ports() == [str(name) for name in names]


@pytest.mark.parametrize("kind", ["missing", "empty"])
def test_without_such_names_the_devices_are_told(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "by-id"
    if kind != "missing":
        folder.mkdir()
    monkeypatch.setattr(ports, "_BY_ID", folder)
    assert ports.serial_ports() == DEVICES


@pytest.mark.parametrize(
    "path", ["tcp://", "tcp://host", "tcp://:6000", "tcp://host:x", "tcp://host:70000", "host:6000"]
)
def test_what_is_no_address(path: str) -> None:
    with raises(ConfigError, "config.hand_port"):
        ports.tcp_address(path)


def test_addresses() -> None:
    assert ports.tcp_address("tcp://192.168.11.210:6000") == ("192.168.11.210", 6000)
    assert ports.tcp_address("tcp://hand.lab:0") == ("hand.lab", 0)
