"""The emulated RH56 that does not take, or does not acknowledge, what is written: reads are answered all the same."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.runtime.readable import readable
from toolee_robot.sim_backend.hands.ability import AbilityEmulator
from toolee_robot.sim_backend.hands.inspire import Hand, InspireEmulator, ModbusEmulator, foreign
from toolee_robot.sim_backend.hands.kit import LineFaults, WriteFault, happen
from toolee_robot.sim_backend.hands.shadow import ShadowEmulator


@dataclass(frozen=True)
class Frames:
    """What goes over one of the wires."""

    read: str
    write: str
    written: str
    read_500: str
    read_300: str


SERIAL = Frames(
    "EB 90 01 04 11 DA 05 0C 01",
    "EB 90 01 0F 12 DA 05 " + "2C 01 " * 6 + "0F",
    "90 EB 01 04 12 DA 05 01 F7",
    "90 EB 01 0F 11 DA 05 " + "F4 01 " * 6 + "BE",
    "90 EB 01 0F 11 DA 05 " + "2C 01 " * 6 + "0E",
)
MODBUS = Frames(
    "00 01 00 00 00 06 01 03 05 DA 00 06",
    "00 01 00 00 00 13 01 10 05 DA 00 06 0C " + "01 2C " * 6,
    "00 01 00 00 00 06 01 10 05 DA 00 06",
    "00 01 00 00 00 0F 01 03 0C " + "01 F4 " * 6,
    "00 01 00 00 00 0F 01 03 0C " + "01 2C " * 6,
)
"""The thresholds of the force: read, and written as 300."""
WRITE_ONE_MODBUS = "00 02 00 00 00 06 01 06 05 DA 01 2C"
SILENCE = 0.3
"""Time after which no answer comes [s]."""


def test_what_becomes_of_a_write() -> None:
    faults, done = LineFaults(foreign), []

    def carry_out() -> list[str]:
        done.append(1)
        return ["done"]

    assert (faults.write(carry_out), len(done)) == (["done"], 1)
    faults.writes = WriteFault.UNACKNOWLEDGED
    assert (faults.write(carry_out), len(done)) == ([], 2)
    faults.writes = WriteFault.DEAF
    assert (faults.write(carry_out), len(done)) == ([], 2)


@pytest.mark.parametrize("fault", WriteFault)
def test_every_function_of_modbus_that_writes(fault: WriteFault) -> None:
    server = ModbusEmulator()
    faults = server.faults
    faults.writes = fault
    for frame in (WRITE_ONE_MODBUS, MODBUS.write):
        assert server.answer(bytes.fromhex(frame)) == []
    assert server.tell(lambda hand: hand.told)[0][1] == (500 if fault is WriteFault.DEAF else 300)
    assert len(server.answer(bytes.fromhex(MODBUS.read))) == 1
    server.refusals.append(6)
    assert server.answer(bytes.fromhex(WRITE_ONE_MODBUS)) == []
    faults.writes = None
    assert len(server.answer(bytes.fromhex(WRITE_ONE_MODBUS))) == 1


def test_events() -> None:
    with InspireEmulator() as inspire, ModbusEmulator() as modbus:
        for emulator in (inspire, modbus):
            for fault in WriteFault:
                happen(emulator, fault)
                assert emulator.faults.writes is fault
            happen(emulator, "acknowledge")
            assert emulator.faults.writes is None
            happen(emulator, "error middle 4")
            happen(emulator, "error middle 16")
            assert emulator.tell(lambda hand: hand.read(1606, 6)) == bytes([0, 0, 20, 0, 0, 0])
            for nonsense in ("deaf 3", "error 4", "error middle", "error middle 0", "error middle 2", "error palm 4"):
                with raises(UserError, "user.hand_event"):
                    happen(emulator, nonsense)
    with AbilityEmulator() as ability, ShadowEmulator() as shadow:
        for other in (ability, shadow):
            with raises(UserError, "user.hand_event"):
                happen(other, "deaf")


def test_a_motor_with_too_much_current_stands_until_it_is_cleared() -> None:
    now = 100.0
    hand = Hand(lambda: now)
    hand.write(1486, struct.pack("<6h", *(0,) * 6))
    now += 0.2
    hand.run()
    hand.motors[2].error |= 4
    now += 2.0
    angles = struct.unpack("<6h", hand.read(1546, 12))
    assert angles[2] > 800
    assert angles[3] == 0
    assert (hand.read(1606, 6)[2], hand.read(1612, 6)[2]) == (4, 5)
    assert hand.write(1004, b"\x01")
    assert hand.read(1606, 6) == bytes(6)


Ask = Callable[[str], str]


@pytest.fixture(params=[SERIAL, MODBUS], ids=["rs485", "modbus"])
def wire(request: pytest.FixtureRequest) -> Iterator[tuple[InspireEmulator | ModbusEmulator, Ask, Frames]]:
    """An emulated hand, what asks it, and its frames."""
    frames = request.param
    with InspireEmulator() if frames is SERIAL else ModbusEmulator() as emulator:
        if frames is SERIAL:
            end = os.open(emulator.port, os.O_RDWR | os.O_NOCTTY)
        else:
            host, port = emulator.port.removeprefix("tcp://").split(":")
            end = socket.create_connection((host, int(port))).detach()

        def ask(frame: str) -> str:
            os.write(end, bytes.fromhex(frame))
            found = b""
            while readable([end], SILENCE):
                found += os.read(end, 4096)
            return found.hex(" ").upper()

        yield emulator, ask, frames
        os.close(end)


@pytest.mark.realtime(light=True)
def test_reads_are_answered_and_writes_are_not(
    wire: tuple[InspireEmulator | ModbusEmulator, Ask, Frames],
) -> None:
    emulator, ask, frames = wire
    told = emulator.tell(lambda hand: hand.told)
    happen(emulator, "deaf")
    assert ask(frames.write) == ""
    assert ask(frames.read) == frames.read_500.strip()
    assert emulator.tell(lambda hand: hand.told) == told
    happen(emulator, "unacknowledged")
    assert ask(frames.write) == ""
    assert ask(frames.read) == frames.read_300.strip()
    happen(emulator, "acknowledge")
    assert ask(frames.write) == frames.written
