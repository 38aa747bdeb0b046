"""The Inspire driver on the emulated hand, on RS-485 and on Modbus-TCP: grasps, and what goes wrong with them."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.devices.hands.conftest import InspireWire as Emulator
from tests.errors import raises
from tests.rigs.wired_hands import eventually, told
from toolee_robot.devices.hands.inspire import GRIP_FORCE, UNTAKEN, InspireHand
from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands.inspire import Hand
from toolee_robot.sim_backend.hands.kit import happen

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


def test_the_grip_is_kept_up_and_what_slips_is_told(inspire: Emulator, inspire_hand: InspireHand) -> None:
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
    assert time.monotonic() - began < 0.3, "a lost tool"
    inspire_hand.open()
    assert told(inspire_hand).fault == ""


def test_a_stop_of_a_hand_that_holds_keeps_the_grip(inspire: Emulator, inspire_hand: InspireHand) -> None:
    inspire.tell(lambda hand: hand.hold(HANDLE))
    inspire_hand.close()
    inspire_hand.stop()
    time.sleep(0.2)
    assert told(inspire_hand).holding
    assert min(forces(inspire_hand)) >= GRIP_FORCE
    inspire.tell(lambda hand: hand.slip(20))
    time.sleep(0.2)
    eventually(lambda: min(forces(inspire_hand)) >= GRIP_FORCE)


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


def test_its_state_can_be_asked_at_100_hz_while_it_closes(inspire: Emulator, inspire_hand: InspireHand) -> None:
    inspire.tell(lambda hand: hand.hold(HANDLE))
    with ThreadPoolExecutor() as pool:
        closing = pool.submit(inspire_hand.close)
        ages, q = [], []
        while not closing.done():
            state = inspire_hand.state(max_age=0.5)
            ages.append(HostClock().now() - state.joints.stamp)
            q.append(state.joints.q)
            time.sleep(0.01)
        closing.result()
    assert len(ages) > 50
    assert np.median(ages) < 0.03
    assert q[-1][0] - q[0][0] > 0.5


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
    assert "answers questions" in str(caught.value)
    happen(inspire, "acknowledge")
    inspire_hand.open()
    assert inspire_hand.state(max_age=2.0).fault == ""
