"""The line to the Ability Hand when replies are damaged, late, doubled or not for us: right, or none, or an error."""

from __future__ import annotations

import time
import tracemalloc
from contextlib import suppress

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.devices.hands.ability import AbilityHand
from toolee_robot.devices.hands.ability.line import ATTEMPTS, Answer, HandLine
from toolee_robot.errors import NoAnswerError
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.ability_hand import AbilityEmulator, Hand
from toolee_robot.sim_backend.hand_wire import LineFault

pytestmark = pytest.mark.realtime(light=True)

HERE = (10.0, 20.0, 30.0, 40.0, 50.0, -60.0)


def put(emulator: AbilityEmulator, scale: float = 1.0) -> None:
    """Set the motors down at HERE."""

    def place(hand: Hand) -> None:
        for motor, at in zip(hand.motors, HERE, strict=True):
            motor.position = scale * abs(at)

    emulator.tell(place)


def ask(line: HandLine) -> Answer:
    """Ask until there is a reply."""
    for _ in range(5):
        with suppress(NoAnswerError):
            return line.exchange(None)
    return line.exchange(None)


@pytest.mark.parametrize("fault", LineFault)
def test_a_reading_survives_it(emulator: AbilityEmulator, fault: LineFault) -> None:
    put(emulator)
    with HandLine(emulator.port, 0x50, HostClock()) as line:
        line.find()
        for _ in range(3):
            emulator.faults.upcoming(fault)
            for _ in range(2):
                np.testing.assert_allclose(ask(line).reply.positions, HERE, atol=0.01)


def test_a_late_reply_is_never_taken_for_newer_than_it_is(emulator: AbilityEmulator) -> None:
    emulator.faults.late_by = 0.09
    with HandLine(emulator.port, 0x50, HostClock()) as line:
        put(emulator)
        line.find()
        for count in (1, 2, 3):
            emulator.faults.upcoming(LineFault.LATE, count)
            with suppress(NoAnswerError):
                line.exchange(None)
            moved = HostClock().now()
            put(emulator, 0.5)
            for _ in range(8):
                answer = ask(line)
                old = abs(answer.reply.positions[0] - HERE[0]) < 0.1
                assert not old or answer.stamp <= moved
            put(emulator)
            time.sleep(0.3)
            with suppress(NoAnswerError):
                line.exchange(None)


def test_an_adapter_that_echoes_is_no_hindrance(emulator: AbilityEmulator) -> None:
    emulator.faults.echo = True
    put(emulator)
    with HandLine(emulator.port, 0x50, HostClock()) as line:
        line.find()
        np.testing.assert_allclose(ask(line).reply.positions, HERE, atol=0.01)


def test_a_hand_that_does_not_answer_is_asked_a_bounded_number_of_times(emulator: AbilityEmulator) -> None:
    emulator.faults.muted = True
    with HandLine(emulator.port, 0x50, HostClock()) as line:
        began = time.monotonic()
        with raises(NoAnswerError, "no_answer.hand_silent"):
            line.find()
        assert line.counts.requests == line.counts.unanswered == ATTEMPTS
        assert time.monotonic() - began < 1.0


RATES = {LineFault.GARBAGE: 0.05, LineFault.CORRUPT: 0.03, LineFault.DOUBLED: 0.05, LineFault.FOREIGN: 0.05}


@pytest.mark.parametrize(
    ("duration", "rates"),
    [(1.5, {}), (1.5, RATES), pytest.param(600.0, {}, marks=pytest.mark.nightly)],
    ids=["clean", "noisy", "ten minutes"],
)
def test_polling_loses_no_reply_and_no_memory(
    emulator: AbilityEmulator, hand: AbilityHand, duration: float, rates: dict[LineFault, float]
) -> None:
    hand.open()
    emulator.faults.rates = rates
    time.sleep(0.3)
    tracemalloc.start()
    try:
        before, first = tracemalloc.get_traced_memory()[0], hand.reading(2.0).number
        lost = hand.line_counts.unanswered
        began = time.monotonic()
        while time.monotonic() - began < duration:
            assert hand.state(max_age=2.0).joints.q[0] == pytest.approx(0.0, abs=2e-3)
            time.sleep(0.01)
        taken = time.monotonic() - began
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    readings = hand.reading(2.0).number - first
    lost = hand.line_counts.unanswered - lost
    print(f"{readings / taken:.1f} readings/s for {taken:.1f} s, {lost} without a reply, memory {grown:+d} bytes")
    assert readings > 50 * duration
    assert grown < 200_000
    if not rates:
        assert hand.line_counts.corrupt == 0
        assert lost <= 0.02 * readings, "what the machine holds up for 30 ms"
