"""The line to the hand when replies are damaged, late, doubled or not for us: right, or asked again, or an error."""

from __future__ import annotations

import struct
import time
import tracemalloc

import pytest

from tests.errors import raises
from toolee_robot.errors import NoAnswerError
from toolee_robot.hardware.hands.inspire import InspireHand
from toolee_robot.hardware.hands.inspire.line import ATTEMPTS, HandLine
from toolee_robot.hardware.hands.inspire.registers import ANGLE_ACT, ANGLE_SET, FORCE_SET, pack
from toolee_robot.sim_backend.hand_wire import LineFault
from toolee_robot.sim_backend.inspire_hand import InspireEmulator

pytestmark = pytest.mark.realtime


def angles(line: HandLine) -> tuple[int, ...]:
    return struct.unpack("<6h", line.read(ANGLE_ACT, 12))


@pytest.mark.parametrize("fault", LineFault)
def test_a_reading_survives_it(emulator: InspireEmulator, fault: LineFault) -> None:
    with HandLine(emulator.port, 1) as line:
        for _ in range(3):
            emulator.faults.upcoming(fault)
            assert angles(line) == (1000,) * 6
            assert angles(line) == (1000,) * 6
        assert line.counts.requests <= 18


@pytest.mark.parametrize("fault", LineFault)
def test_a_write_is_carried_out_and_known_to_be(emulator: InspireEmulator, fault: LineFault) -> None:
    with HandLine(emulator.port, 1) as line:
        for force in (300, 400, 500):
            emulator.faults.upcoming(fault)
            line.write(FORCE_SET, pack((force,) * 6))
            assert struct.unpack("<6h", line.read(FORCE_SET, 12)) == (force,) * 6


def test_a_late_reply_is_never_taken_for_a_newer_one(emulator: InspireEmulator) -> None:
    emulator.faults.late_by = 0.08
    with HandLine(emulator.port, 1) as line:
        emulator.faults.upcoming(LineFault.LATE)
        line.write(ANGLE_SET, pack((0,) * 6))
        time.sleep(0.5)
        emulator.faults.upcoming(LineFault.LATE, 2)
        for _ in range(5):
            assert angles(line) == (0,) * 6, "1000 would be the reply of before the motion"


def test_an_adapter_that_echoes_is_no_hindrance(emulator: InspireEmulator) -> None:
    emulator.faults.echo = True
    with HandLine(emulator.port, 1) as line:
        line.write(FORCE_SET, pack((700,) * 6))
        assert angles(line) == (1000,) * 6
        assert line.counts.unanswered == 0


def test_a_hand_that_does_not_answer_is_asked_a_bounded_number_of_times(emulator: InspireEmulator) -> None:
    emulator.faults.muted = True
    with HandLine(emulator.port, 1) as line:
        began = time.monotonic()
        with raises(NoAnswerError, "no_answer.hand_silent"):
            angles(line)
        with raises(NoAnswerError, "no_answer.hand_silent"):
            line.write(ANGLE_SET, pack((0,) * 6))
        assert line.counts.requests == 2 * ATTEMPTS
        assert time.monotonic() - began < 1.0


RATES = {LineFault.GARBAGE: 0.05, LineFault.CORRUPT: 0.03, LineFault.DOUBLED: 0.05, LineFault.FOREIGN: 0.05}


@pytest.mark.parametrize(
    ("duration", "rates"),
    [(1.5, {}), (1.5, RATES), pytest.param(600.0, {}, marks=pytest.mark.nightly)],
    ids=["clean", "noisy", "ten minutes"],
)
def test_polling_loses_no_reply_and_no_memory(
    emulator: InspireEmulator, hand: InspireHand, duration: float, rates: dict[LineFault, float]
) -> None:
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
