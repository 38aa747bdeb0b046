"""What only Modbus-TCP has: transaction identifiers, exceptions, connections; and pymodbus's server as a hand."""

from __future__ import annotations

import asyncio
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from typing import Any

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.errors import raises
from tests.examples import timed
from toolee_robot.devices.hands.inspire import ANGLE_ACT, ANGLE_SET, FORCE_SET, InspireHand, ModbusLine
from toolee_robot.errors import DeviceError, NoAnswerError
from toolee_robot.robots import HandModel
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands.inspire import ModbusEmulator

pytestmark = pytest.mark.realtime

OPEN = struct.pack(">6h", *(1000,) * 6)


@pytest.fixture
def emulator() -> Iterator[ModbusEmulator]:
    with ModbusEmulator() as emulator:
        yield emulator


@pytest.mark.parametrize("shift", [0, -1, 1])
def test_a_hand_may_shift_the_transaction_identifier_by_one(emulator: ModbusEmulator, shift: int) -> None:
    emulator.shift = shift
    with closing(ModbusLine(emulator.port, 1)) as line:
        assert line.read(ANGLE_ACT, 12) == OPEN
        line.write(FORCE_SET, struct.pack(">6h", *(300,) * 6))
        assert line.read(FORCE_SET, 12) == struct.pack(">6h", *(300,) * 6)
        assert line.counts.unanswered == 0
        emulator.shift = shift + 1
        with raises(NoAnswerError, "no_answer.hand_silent"):
            line.read(ANGLE_ACT, 12)


@pytest.mark.parametrize("shift", [*(pytest.param(s, marks=pytest.mark.nightly) for s in (-2, 256)), 5])
def test_a_hand_that_numbers_its_replies_in_no_known_way_is_refused(emulator: ModbusEmulator, shift: int) -> None:
    emulator.shift = shift
    with raises(NoAnswerError, "no_answer.hand_silent"):
        ModbusLine(emulator.port, 1)


def test_the_hand_of_another_unit_does_not_answer(emulator: ModbusEmulator) -> None:
    with raises(NoAnswerError, "no_answer.hand_silent"):
        ModbusLine(emulator.port, 2)
    assert emulator.ignored > 0


@timed
def test_it_waits_for_a_hand_that_ends_a_connection_made_at_once(emulator: ModbusEmulator, timed: bool) -> None:
    with closing(ModbusLine(emulator.port, 1)) as line:
        line.read(ANGLE_ACT, 12)
    began = time.monotonic()
    with closing(ModbusLine(emulator.port, 1)) as line:
        assert line.read(ANGLE_ACT, 12) == OPEN
    assert not timed or time.monotonic() - began > 0.3, "the emulated hand ended the first one"


@contextmanager
def serving(serve: Callable[[socket.socket], None]) -> Iterator[str]:
    """A server written in a few lines; `serve` gets its connections, one after the other."""
    listener = socket.create_server(("127.0.0.1", 0))

    def run() -> None:
        with suppress(OSError):
            while True:
                connection, _ = listener.accept()
                with connection, suppress(OSError):
                    serve(connection)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join(2.0)


def test_a_server_that_ends_every_connection_is_somebody_elses() -> None:
    with (
        serving(lambda connection: connection.close()) as port,
        raises(NoAnswerError, says="ends every connection at once"),
    ):
        ModbusLine(port, 1)


def test_a_server_that_talks_without_end_is_no_hand_and_costs_no_memory() -> None:
    def chatter(connection: socket.socket) -> None:
        while True:
            connection.sendall(bytes(range(256)) * 64)

    began = time.monotonic()
    with serving(chatter) as port, raises(NoAnswerError, "no_answer.hand_silent"):
        ModbusLine(port, 1)
    assert time.monotonic() - began < 5.0


def test_a_dead_connection_is_found_at_the_next_request() -> None:
    gone = threading.Event()

    def serve(connection: socket.socket) -> None:
        while not gone.is_set():
            for reply in hand.answer(connection.recv(4096)):
                connection.sendall(reply)

    with ModbusEmulator() as hand, serving(serve) as port, closing(ModbusLine(port, 1)) as line:
        assert line.read(ANGLE_ACT, 12) == OPEN
        gone.set()
        with raises(NoAnswerError, "no_answer.hand_unplugged"):
            for _ in range(2):
                line.read(ANGLE_ACT, 12)


@contextmanager
def pymodbus_hand(registers: dict[int, list[int]]) -> Iterator[str]:
    """pymodbus's server, whose registers are words at the hand's addresses."""
    words = [0] * 2000
    for address, values in registers.items():
        words[address - 1000 : address - 1000 + len(values)] = values
    device = SimDevice(1, SimData(1000, values=words, datatype=DataType.REGISTERS))
    loop = asyncio.new_event_loop()
    ready: list[ModbusTcpServer] = []

    async def serve() -> None:
        server = ModbusTcpServer(device, address=("127.0.0.1", 0))
        await server.listen()
        ready.append(server)

    loop.run_until_complete(serve())
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    transport: Any = ready[0].transport
    port = transport.sockets[0].getsockname()[1]
    try:
        yield f"tcp://127.0.0.1:{port}"
    finally:
        loop.call_soon_threadsafe(ready[0].close)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(2.0)
        loop.close()


@pytest.mark.usefixtures("unhurried")
def test_the_line_talks_to_pymodbus(inspire_model: HandModel) -> None:
    registers = {ANGLE_ACT: [1000, 900, 800, 700, 600, 500]}
    with pymodbus_hand(registers) as port, closing(ModbusLine(port, 1)) as line:
        assert line.numbers(ANGLE_ACT) == (1000, 900, 800, 700, 600, 500)
        target = struct.pack(">6h", 1, 2, 3, 4, 5, -1)
        line.write(ANGLE_SET, target)
        assert line.read(ANGLE_SET, 12) == target
        line.write(1004, line.one)
        assert line.read(1004, 2) == b"\x00\x01"
        with raises(DeviceError, "device.hand_refuses"):
            line.read(0xFFF0, 12)
        assert line.counts.unanswered == 0
    with pymodbus_hand(registers) as port, InspireHand(inspire_model, port, HostClock()) as hand:
        assert hand.reading(1.0).said == (1000, 900, 800, 700, 600, 500)
