"""The serial ports that a person is told of when the hand's is not there."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from serial.tools.list_ports import comports

from toolee_robot.devices.hands.wire import port

DEVICES = sorted(found.device for found in comports())


class _Vanishing(type(Path())):  # type: ignore[misc]  # Path itself cannot be subclassed before Python 3.12
    """A folder that goes once it was found, as udev's does with the last device."""

    def iterdir(self) -> Iterator[Path]:
        shutil.rmtree(self, ignore_errors=True)
        return super().iterdir()


def test_names_that_stay_the_same_are_told_before_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [tmp_path / "usb-FTDI_RS485-if00-port0", tmp_path / "usb-Prolific_2303-if00-port0"]
    for name in reversed(names):
        name.touch()
    monkeypatch.setattr(port, "_BY_ID", tmp_path)
    assert port.serial_ports() == [str(name) for name in names]


@pytest.mark.parametrize("kind", ["missing", "empty", "vanishing"])
def test_without_such_names_the_devices_are_told(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "by-id"
    if kind != "missing":
        folder.mkdir()
    monkeypatch.setattr(port, "_BY_ID", _Vanishing(folder) if kind == "vanishing" else folder)
    assert port.serial_ports() == DEVICES
