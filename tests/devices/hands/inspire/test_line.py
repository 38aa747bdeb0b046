"""The line to the hand when replies are damaged, late, doubled or not for us: right, or asked again, or an error."""

from __future__ import annotations

import struct
import time
import tracemalloc
from typing import Any

import pytest

from tests.devices.hands.inspire.conftest import PACE, Emulator
from tests.errors import raises
from toolee_robot.devices.hands.inspire import InspireHand
from toolee_robot.devices.hands.inspire.line import ATTEMPTS, HandLine
from toolee_robot.devices.hands.inspire.modbus_line import ModbusLine
from toolee_robot.devices.hands.inspire.registers import ANGLE_ACT, ANGLE_SET, FORCE_SET, pack
from toolee_robot.devices.hands.inspire.serial_line import SerialLine
from toolee_robot.errors import NoAnswerError
from toolee_robot.sim_backend.hand_wire import LineFault
from toolee_robot.sim_backend.inspire_hand import InspireEmulator

pytestmark = pytest.mark.realtime(light=True)


Line = HandLine[Any]


def line_to(emulator: Emulator) -> Line:
    return (SerialLine if isinstance(emulator, InspireEmulator) else ModbusLine)(emulator.port, 1)


def numbers(line: Line, register: int) -> tuple[int, ...]:
    return struct.unpack(f"{line.order}6h", line.read(register, 12))


def angles(line: Line) -> tuple[int, ...]:
    return numbers(line, ANGLE_ACT)


def write(line: Line, register: int, value: int) -> None:
    line.write(register, pack((value,) * 6, line.order))


@pytest.mark.parametrize("fault", LineFault)
def test_a_reading_survives_it(emulator: Emulator, fault: LineFault) -> None:
    with line_to(emulator) as line:
        asked = line.counts.requests
        for _ in range(3):
            emulator.faults.upcoming(fault)
            assert angles(line) == (1000,) * 6
            assert angles(line) == (1000,) * 6
        assert line.counts.requests - asked <= 18


@pytest.mark.parametrize("fault", LineFault)
def test_a_write_is_carried_out_and_known_to_be(emulator: Emulator, fault: LineFault) -> None:
    with line_to(emulator) as line:
        for force in (300, 400, 500):
            emulator.faults.upcoming(fault)
            write(line, FORCE_SET, force)
            assert numbers(line, FORCE_SET) == (force,) * 6


def test_a_late_reply_is_never_taken_for_a_newer_one(emulator: Emulator) -> None:
    emulator.faults.late_by = 0.08
    with line_to(emulator) as line:
        emulator.faults.upcoming(LineFault.LATE)
        write(line, ANGLE_SET, 0)
        time.sleep(0.5)
        emulator.faults.upcoming(LineFault.LATE, 2)
        for _ in range(5):
            assert angles(line) == (0,) * 6, "1000 would be the reply of before the motion"


@pytest.mark.usefixtures("unhurried")
def test_an_adapter_that_echoes_is_no_hindrance() -> None:
    with InspireEmulator() as emulator, SerialLine(emulator.port, 1) as line:
        emulator.faults.echo = True
        write(line, FORCE_SET, 700)
        assert angles(line) == (1000,) * 6
        assert line.counts.unanswered == 0


def test_a_hand_that_does_not_answer_is_asked_a_bounded_number_of_times(emulator: Emulator) -> None:
    with line_to(emulator) as line:
        emulator.faults.muted = True
        asked, began = line.counts.requests, time.monotonic()
        with raises(NoAnswerError, "no_answer.hand_silent"):
            angles(line)
        with raises(NoAnswerError, "no_answer.hand_silent"):
            write(line, ANGLE_SET, 0)
        assert line.counts.requests - asked <= 3 * ATTEMPTS
        assert time.monotonic() - began < 1.0


RATES = {LineFault.GARBAGE: 0.05, LineFault.CORRUPT: 0.03, LineFault.DOUBLED: 0.05, LineFault.FOREIGN: 0.05}


@pytest.mark.parametrize(
    ("duration", "rates"),
    [(1.5, {}), (1.5, RATES), pytest.param(600.0, {}, marks=pytest.mark.nightly)],
    ids=["clean", "noisy", "ten minutes"],
)
def test_polling_loses_no_reply_and_no_memory(
    emulator: Emulator,
    hand: InspireHand,
    duration: float,
    rates: dict[LineFault, float],
    request: pytest.FixtureRequest,
) -> None:
    if not rates:
        request.getfixturevalue("unhurried")
    emulator.faults.rates = rates
    time.sleep(0.5)
    tracemalloc.start()
    try:
        before, first = tracemalloc.get_traced_memory()[0], hand.reading(2.0).number
        end = time.monotonic() + duration
        while time.monotonic() < end:
            assert hand.state(max_age=2.0).joints.q[0] == 0.0
            time.sleep(0.01)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert hand.reading(2.0).number - first > 20 * duration
    assert grown < 200_000
    if not rates:
        assert hand.line_counts.unanswered == 0


def test_an_emulated_hand_that_was_left_alone_answers_the_first_request_at_once(emulator: Emulator) -> None:
    time.sleep(0.5)
    behind: list[float] = []
    emulator.tell(lambda hand: behind.append(hand._clock() - hand._now))
    assert behind[0] < 0.4 * PACE, "it would have to catch up first"
