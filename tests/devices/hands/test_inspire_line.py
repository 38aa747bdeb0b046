"""The line to the hand when replies are damaged, late, doubled or not for us: right, or asked again, or an error."""

from __future__ import annotations

import struct
import time
from contextlib import closing

import pytest

from tests.devices.hands.conftest import PACE, InspireWire
from tests.errors import raises
from toolee_robot.devices.hands.inspire import (
    ANGLE_ACT,
    ANGLE_SET,
    ATTEMPTS,
    FORCE_SET,
    InspireLine,
    ModbusLine,
    SerialLine,
)
from toolee_robot.errors import NoAnswerError
from toolee_robot.sim_backend.hands.inspire import InspireEmulator, ModbusEmulator
from toolee_robot.sim_backend.hands.kit import LineFault

pytestmark = pytest.mark.realtime(light=True)


def line_to(emulator: InspireWire) -> closing[InspireLine]:
    kind = ModbusLine if isinstance(emulator, ModbusEmulator) else SerialLine
    return closing(kind(emulator.port, 1))


def angles(line: InspireLine) -> tuple[int, ...]:
    return line.numbers(ANGLE_ACT)


def write(line: InspireLine, register: int, value: int) -> None:
    line.write(register, struct.pack(f"{line.order}6h", *(value,) * 6))


@pytest.mark.parametrize("fault", LineFault)
def test_a_reading_survives_it_and_a_write_is_carried_out(inspire: InspireWire, fault: LineFault) -> None:
    with line_to(inspire) as line:
        asked = line.counts.requests
        for _ in range(3):
            inspire.faults.upcoming(fault)
            assert angles(line) == (1000,) * 6
            assert angles(line) == (1000,) * 6
        assert line.counts.requests - asked <= 18
        for force in (300, 400, 500):
            inspire.faults.upcoming(fault)
            write(line, FORCE_SET, force)
            assert line.numbers(FORCE_SET) == (force,) * 6, "known to be carried out"


def test_a_late_reply_is_never_taken_for_a_newer_one(inspire: InspireWire) -> None:
    inspire.faults.late_by = 0.08
    with line_to(inspire) as line:
        inspire.faults.upcoming(LineFault.LATE)
        write(line, ANGLE_SET, 0)
        time.sleep(0.5)
        inspire.faults.upcoming(LineFault.LATE, 2)
        for _ in range(5):
            assert angles(line) == (0,) * 6, "1000 would be the reply of before the motion"


@pytest.mark.usefixtures("unhurried")
def test_an_adapter_that_echoes_is_no_hindrance() -> None:
    with InspireEmulator() as emulator, closing(SerialLine(emulator.port, 1)) as line:
        emulator.faults.echo = True
        write(line, FORCE_SET, 700)
        assert angles(line) == (1000,) * 6
        assert line.counts.unanswered == 0


def test_a_hand_that_does_not_answer_is_asked_a_bounded_number_of_times(inspire: InspireWire) -> None:
    with line_to(inspire) as line:
        inspire.faults.muted = True
        asked, began = line.counts.requests, time.monotonic()
        with raises(NoAnswerError, "no_answer.hand_silent"):
            angles(line)
        with raises(NoAnswerError, "no_answer.hand_silent"):
            write(line, ANGLE_SET, 0)
        assert line.counts.requests - asked <= 3 * ATTEMPTS
        assert time.monotonic() - began < 1.0


def test_an_emulated_hand_that_was_left_alone_answers_the_first_request_at_once(inspire: InspireWire) -> None:
    time.sleep(0.5)
    behind: list[float] = []
    inspire.tell(lambda hand: behind.append(hand._clock() - hand.now))
    assert behind[0] < 0.4 * PACE, "it would have to catch up first"
