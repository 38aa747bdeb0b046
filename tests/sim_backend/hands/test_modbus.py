"""The emulated RH56's Modbus-TCP: the specification's rules, byte for byte, and pymodbus's client on it."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client import ModbusTcpClient

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.sim_backend.hands.inspire import Hand, ModbusEmulator

READ_ANGLES = "00 01 00 00 00 06 01 03 06 0A 00 06"


class Bench:
    """A hand whose time is set by hand, and its server."""

    def __init__(self) -> None:
        self.now = 100.0
        self.hand = Hand(lambda: self.now)
        self.emulator = ModbusEmulator()
        self.emulator._hand = self.hand

    def send(self, frame: str) -> list[str]:
        return [reply.hex(" ").upper() for reply in self.emulator.answer(bytes.fromhex(frame))]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_two_single_bytes_share_a_register_and_a_block_is_read_at_once(bench: Bench) -> None:
    for i, motor in enumerate(bench.hand.motors):
        motor.temperature, motor.status, motor.error = 30.0 + i, i % 4, 1 << (i % 3)
    (temperatures,) = bench.send("00 01 00 00 00 06 01 03 06 52 00 03")
    assert temperatures == "00 01 00 00 00 09 01 03 06 1E 1F 20 21 22 23"
    (all_of_it,) = bench.send("00 01 00 00 00 06 01 03 06 2E 00 15")
    data = bytes.fromhex(all_of_it)[9:]
    assert struct.unpack(">6h", data[:12]) == (0,) * 6
    assert struct.unpack(">6h", data[12:24]) == (20,) * 6
    assert data[24:30] == bytes([1, 2, 4, 1, 2, 4])
    assert data[30:36] == bytes([0, 1, 2, 3, 0, 1])
    assert data[36:] == bytes(range(30, 36))


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("04 06 0A 00 06", 1),  # input registers
        ("03 06 0A 00 00", 3),
        ("03 06 0A 00 7E", 3),
        ("03 06 0A 00", 3),
        ("03 00 00 00 01", 2),
        ("03 14 02 00 02", 2),  # beyond the last one
        ("10 06 0A 00 01 02 00 00", 2),  # an angle that was measured
        ("10 05 CE 00 01 04 00 00", 3),
        ("10 05 CE 00 02 04 00 00", 3),
        ("06 03 EC 00 02", 3),
        ("06 00 01 00 00", 2),
    ],
)
def test_what_it_cannot_do_is_an_exception(bench: Bench, request_: str, code: int) -> None:
    body = bytes.fromhex(request_)
    frame = struct.pack(">HHHB", 5, 0, 1 + len(body), 1) + body
    assert bench.emulator.answer(frame) == [bytes([0, 5, 0, 0, 0, 3, 1, body[0] | 0x80, code])]


@given(st.binary(max_size=400))
def test_no_bytes_bring_it_down(data: bytes) -> None:
    bench = Bench()
    bench.emulator.answer(data)
    bench.emulator.connected()
    assert bench.send(READ_ANGLES)


def test_it_cannot_listen_where_another_does() -> None:
    with ModbusEmulator() as emulator:
        host, port = emulator.port.removeprefix("tcp://").split(":")
        with raises(UserError, "user.address"):
            ModbusEmulator((host, int(port)))


@pytest.mark.realtime
def test_pymodbus_drives_it() -> None:
    with ModbusEmulator(pace=4.0) as emulator:
        host, port = emulator.port.removeprefix("tcp://").split(":")
        with ModbusTcpClient(host, port=int(port), timeout=1.0) as client:
            assert client.read_holding_registers(1546, count=6, device_id=1).registers == [1000] * 6
            assert not client.write_registers(1486, [400, 400, 400, 400, 1000, 0xFFFF], device_id=1).isError()
            assert not client.write_register(1004, 1, device_id=1).isError()
            assert client.read_holding_registers(1618, count=3, device_id=1).registers == [0x1F1F] * 3
            refused = client.read_holding_registers(6000, count=1, device_id=1)
            assert refused.isError()
            assert refused.exception_code == 2
            while emulator.angles[0] >= 400.5:  # 401 as a register
                pass
            assert client.read_holding_registers(1546, count=6, device_id=1).registers == [400] * 4 + [1000] * 2
