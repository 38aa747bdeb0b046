"""The Inspire driver on the emulated hand, on RS-485 and on Modbus-TCP: grasps, and what goes wrong with them."""

from __future__ import annotations

import struct
import time
from contextlib import closing

import pytest

from tests.devices.hands.conftest import PACE, InspireWire
from tests.devices.hands.conftest import InspireWire as Emulator
from tests.errors import raises
from tests.examples import timed
from tests.rigs.wired_hands import eventually, told
from toolee_robot.devices.hands.inspire import (
    ANGLE_ACT,
    ANGLE_SET,
    ATTEMPTS,
    FORCE_SET,
    GRIP_FORCE,
    UNTAKEN,
    InspireHand,
    InspireLine,
    ModbusLine,
    SerialLine,
)
from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.sim_backend.hands.inspire import Hand, InspireEmulator, ModbusEmulator
from toolee_robot.sim_backend.hands.kit import LineFault, happen

pytestmark = pytest.mark.realtime(light=True)

HANDLE = 400
"""Angle at which the fingers meet a handle [counts]."""


def forces(hand: InspireHand) -> tuple[float, ...]:
    """Of the motors that press [counts]."""
    return tuple(hand.reading(max_age=1.0).forces[:5])


def test_it_closes_with_the_grip_force_and_not_much_more(inspire: Emulator, inspire_hand: InspireHand) -> None:
    inspire.tell(lambda hand: hand.hold(HANDLE))
    inspire_hand.close()
    state = told(inspire_hand)
    assert state.holding
    assert state.fault == ""
    assert all(GRIP_FORCE <= force <= 1.1 * GRIP_FORCE for force in forces(inspire_hand))
    assert all(4.0 < force < 12.0 for force in state.contact_forces.values())
    inspire_hand.open()
    assert not told(inspire_hand).holding


@timed
def test_the_grip_is_kept_up_and_what_slips_is_told(inspire: Emulator, inspire_hand: InspireHand, timed: bool) -> None:
    inspire.tell(lambda hand: hand.hold(HANDLE))
    inspire_hand.close()
    inspire.tell(lambda hand: hand.slip(20))
    time.sleep(0.2)
    eventually(lambda: min(forces(inspire_hand)) >= GRIP_FORCE)
    assert told(inspire_hand).holding
    assert told(inspire_hand).fault == "", "a little is no slip"
    inspire.tell(lambda hand: hand.slip(40))
    eventually(lambda: "slipped" in told(inspire_hand).fault)
    inspire.tell(lambda hand: hand.hold(None))
    began = time.monotonic()
    eventually(lambda: not told(inspire_hand).holding)
    assert not timed or time.monotonic() - began < 0.3, "a lost tool"
    inspire_hand.open()
    assert told(inspire_hand).fault == ""


def jam(hand: Hand) -> None:
    hand.motors[3].jammed = True


def free(hand: Hand) -> None:
    hand.motors[3].jammed = hand.motors[3].says_arrived = False


def test_a_stall_is_an_error_that_a_person_clears(inspire: Emulator, inspire_hand: InspireHand) -> None:
    inspire.tell(jam)
    with raises(DeviceError, "device.hand_stall"):
        inspire_hand.close()
    assert "index: stalled" in told(inspire_hand).fault
    inspire.tell(free)
    with raises(DeviceError, "device.hand_stall"):
        inspire_hand.close()
    inspire_hand.clear_faults()
    eventually(lambda: told(inspire_hand).fault == "")
    inspire_hand.close()


def test_a_finger_that_is_stuck_does_not_pass_for_open(inspire: Emulator, inspire_hand: InspireHand) -> None:
    inspire.tell(lambda hand: setattr(hand.motors[3], "position", 300.0))
    inspire.tell(jam)
    inspire.tell(lambda hand: setattr(hand.motors[3], "says_arrived", True))
    with raises(DeviceError, "device.hand_blocked"):
        inspire_hand.open()


def test_a_hot_hand_is_not_closed_but_says_how_hot_it_is(inspire: Emulator, inspire_hand: InspireHand) -> None:
    inspire.tell(lambda hand: setattr(hand.motors[1], "temperature", 72.0))
    eventually(lambda: "ring: too hot" in told(inspire_hand).fault)
    assert told(inspire_hand).temperature == 72.0
    with raises(DeviceError, "device.hand_over_temperature"):
        inspire_hand.close()


def test_a_silent_hand_has_no_state_until_it_answers_again(inspire: Emulator, inspire_hand: InspireHand) -> None:
    inspire.faults.muted = True
    time.sleep(0.5)
    with raises(StaleDataError, "stale_data.hand"):
        inspire_hand.state()
    assert inspire_hand.state(max_age=5.0) is not None
    with raises(StaleDataError, "stale_data.hand"):
        inspire_hand.close()
    with raises(NoAnswerError, "no_answer.hand_silent"):
        inspire_hand.clear_faults()
    inspire.faults.muted = False
    time.sleep(0.3)
    assert inspire_hand.state() is not None


def test_a_hand_that_answers_and_takes_no_command_says_so_until_it_takes_one(
    inspire: Emulator, inspire_hand: InspireHand
) -> None:
    """Its grip would go slack unseen: state is told on."""
    inspire.tell(lambda hand: hand.hold(HANDLE))
    inspire_hand.close()
    happen(inspire, "deaf")
    inspire.tell(lambda hand: hand.slip(25))  # takes half of the force, and is no slip yet
    eventually(lambda: inspire_hand.state(max_age=2.0).fault == UNTAKEN)
    assert inspire_hand.state(max_age=2.0).holding
    with raises(NoAnswerError, "no_answer.hand_write") as caught:
        inspire_hand.open()
    assert "answers, but does not take what is written" in str(caught.value)
    happen(inspire, "acknowledge")
    inspire_hand.open()
    assert inspire_hand.state(max_age=2.0).fault == ""


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


@timed
def test_a_hand_that_does_not_answer_is_asked_a_bounded_number_of_times(inspire: InspireWire, timed: bool) -> None:
    with line_to(inspire) as line:
        inspire.faults.muted = True
        asked, began = line.counts.requests, time.monotonic()
        with raises(NoAnswerError, "no_answer.hand_silent"):
            angles(line)
        with raises(NoAnswerError, "no_answer.hand_silent"):
            write(line, ANGLE_SET, 0)
        assert line.counts.requests - asked <= 3 * ATTEMPTS
        assert not timed or time.monotonic() - began < 1.0


@pytest.mark.nightly
def test_an_emulated_hand_that_was_left_alone_answers_the_first_request_at_once(inspire: InspireWire) -> None:
    time.sleep(0.5)
    behind: list[float] = []
    inspire.tell(lambda hand: behind.append(hand._clock() - hand.now))
    assert behind[0] < 0.4 * PACE, "it would have to catch up first"
