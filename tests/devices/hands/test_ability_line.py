"""The line to the Ability Hand when replies are damaged, late, doubled or not for us: right, or none, or an error."""

from __future__ import annotations

import time
from contextlib import closing, suppress

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.devices.hands.ability import ATTEMPTS, AbilityLine, Reply
from toolee_robot.errors import NoAnswerError
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands.ability import AbilityEmulator, Hand
from toolee_robot.sim_backend.hands.kit import LineFault

pytestmark = pytest.mark.realtime(light=True)

HERE = (10.0, 20.0, 30.0, 40.0, 50.0, -60.0)


def put(emulator: AbilityEmulator, scale: float = 1.0) -> None:
    """Set the motors down at HERE."""

    def place(hand: Hand) -> None:
        for motor, at in zip(hand.motors, HERE, strict=True):
            motor.position = scale * abs(at)

    emulator.tell(place)


def ask(line: AbilityLine) -> tuple[float, Reply]:
    """Ask until there is a reply."""
    for _ in range(5):
        with suppress(NoAnswerError):
            return line.exchange(None)
    return line.exchange(None)


@pytest.mark.parametrize("fault", LineFault)
def test_a_reading_survives_it(ability: AbilityEmulator, fault: LineFault) -> None:
    put(ability)
    with closing(AbilityLine(ability.port, 0x50, HostClock())) as line:
        line.find()
        for _ in range(3):
            ability.faults.upcoming(fault)
            for _ in range(2):
                np.testing.assert_allclose(ask(line)[1].positions, HERE, atol=0.01)


def test_a_late_reply_is_never_taken_for_newer_than_it_is(ability: AbilityEmulator) -> None:
    ability.faults.late_by = 0.09
    with closing(AbilityLine(ability.port, 0x50, HostClock())) as line:
        put(ability)
        line.find()
        for count in (1, 2, 3):
            ability.faults.upcoming(LineFault.LATE, count)
            with suppress(NoAnswerError):
                line.exchange(None)
            moved = HostClock().now()
            put(ability, 0.5)
            for _ in range(8):
                stamp, reply = ask(line)
                old = abs(reply.positions[0] - HERE[0]) < 0.1
                assert not old or stamp <= moved
            put(ability)
            time.sleep(0.3)
            with suppress(NoAnswerError):
                line.exchange(None)


def test_an_adapter_that_echoes_is_no_hindrance(ability: AbilityEmulator) -> None:
    ability.faults.echo = True
    put(ability)
    with closing(AbilityLine(ability.port, 0x50, HostClock())) as line:
        line.find()
        np.testing.assert_allclose(ask(line)[1].positions, HERE, atol=0.01)


def test_a_hand_that_does_not_answer_is_asked_a_bounded_number_of_times(ability: AbilityEmulator) -> None:
    ability.faults.muted = True
    with closing(AbilityLine(ability.port, 0x50, HostClock())) as line:
        began = time.monotonic()
        with raises(NoAnswerError, "no_answer.hand_silent"):
            line.find()
        assert line.counts.requests == line.counts.unanswered == ATTEMPTS
        assert time.monotonic() - began < 1.0
