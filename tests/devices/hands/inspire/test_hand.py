"""The Inspire driver on the emulated hand, on RS-485 and on Modbus-TCP: grasps, and what goes wrong with them."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.devices.hands.inspire.conftest import Emulator
from tests.errors import raises
from toolee_robot.devices.hands.inspire import InspireHand
from toolee_robot.devices.hands.inspire.hand import GRIP_FORCE, UNTAKEN
from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.hal import HandState
from toolee_robot.robots import HandModel
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hand_wire import happen
from toolee_robot.sim_backend.inspire_hand import Hand, InspireEmulator

pytestmark = pytest.mark.realtime(light=True)

HANDLE = 400
"""Angle at which the fingers meet a handle [counts]."""


def eventually(condition: Callable[[], bool], within: float = 3.0) -> None:
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def told(hand: InspireHand) -> HandState:
    """Its state, however busy this machine is."""
    return hand.state(max_age=1.0)


def forces(hand: InspireHand) -> tuple[int, ...]:
    """Of the motors that press [counts]."""
    return hand.reading(max_age=1.0).condition.forces[:5]


def test_it_closes_with_the_grip_force_and_not_much_more(emulator: Emulator, hand: InspireHand) -> None:
    emulator.tell(lambda hand: hand.hold(HANDLE))
    hand.close()
    state = told(hand)
    assert state.holding
    assert state.fault == ""
    assert all(GRIP_FORCE <= force <= 1.1 * GRIP_FORCE for force in forces(hand))
    assert all(4.0 < force < 12.0 for force in state.contact_forces.values())
    hand.open()
    assert not told(hand).holding


def test_the_grip_is_kept_up_and_what_slips_is_told(emulator: Emulator, hand: InspireHand) -> None:
    emulator.tell(lambda hand: hand.hold(HANDLE))
    hand.close()
    emulator.tell(lambda hand: hand.slip(20))
    time.sleep(0.2)
    eventually(lambda: min(forces(hand)) >= GRIP_FORCE)
    assert told(hand).holding
    assert told(hand).fault == "", "a little is no slip"
    emulator.tell(lambda hand: hand.slip(40))
    eventually(lambda: "slipped" in told(hand).fault)
    emulator.tell(lambda hand: hand.hold(None))
    began = time.monotonic()
    eventually(lambda: not told(hand).holding)
    assert time.monotonic() - began < 0.3, "a lost tool"
    hand.open()
    assert told(hand).fault == ""


def test_a_stop_freezes_the_fingers_and_ends_the_motion(emulator: Emulator, hand: InspireHand) -> None:
    with ThreadPoolExecutor() as pool:
        closing = pool.submit(hand.close)
        eventually(lambda: emulator.angles[0] < 700)
        hand.stop()
        with raises(DeviceError, "device.stopped"):
            closing.result(5.0)
    time.sleep(0.1)
    stands = emulator.angles
    assert min(stands[:4]) > 350
    time.sleep(0.2)
    assert emulator.angles == stands
    hand.open()


def test_a_stop_of_a_hand_that_holds_keeps_the_grip(emulator: Emulator, hand: InspireHand) -> None:
    emulator.tell(lambda hand: hand.hold(HANDLE))
    hand.close()
    hand.stop()
    time.sleep(0.2)
    assert told(hand).holding
    assert min(forces(hand)) >= GRIP_FORCE
    emulator.tell(lambda hand: hand.slip(20))
    time.sleep(0.2)
    eventually(lambda: min(forces(hand)) >= GRIP_FORCE)


def test_a_time_out_keeps_position_and_grip(model: HandModel) -> None:
    with InspireEmulator() as emulator, InspireHand(model, emulator.port, HostClock()) as hand:
        emulator.tell(lambda hand: setattr(hand.motors[5], "position", 0.0))
        with raises(DeviceError, "device.timeout"):
            hand.close(timeout=1.2)
        time.sleep(0.2)
        stands = emulator.angles
        assert 200 < stands[0] < 950
        time.sleep(0.2)
        assert emulator.angles == stands
        emulator.tell(lambda hand: hand.hold(stands[0] - 50.0))
        hand.close()
        with raises(DeviceError, "device.timeout"):
            hand.open(timeout=0.01)
        time.sleep(0.2)
        assert told(hand).holding


def jam(hand: Hand) -> None:
    hand.motors[3].jammed = True


def free(hand: Hand) -> None:
    hand.motors[3].jammed = hand.motors[3].says_arrived = False


def test_a_stall_is_an_error_that_a_person_clears(emulator: Emulator, hand: InspireHand) -> None:
    emulator.tell(jam)
    with raises(DeviceError, "device.hand_stall"):
        hand.close()
    assert "index: stalled" in told(hand).fault
    emulator.tell(free)
    with raises(DeviceError, "device.hand_stall"):
        hand.close()
    hand.clear_faults()
    eventually(lambda: told(hand).fault == "")
    hand.close()


def test_a_finger_that_is_stuck_does_not_pass_for_open(emulator: Emulator, hand: InspireHand) -> None:
    emulator.tell(lambda hand: setattr(hand.motors[3], "position", 300.0))
    emulator.tell(jam)
    emulator.tell(lambda hand: setattr(hand.motors[3], "says_arrived", True))
    with raises(DeviceError, "device.hand_blocked"):
        hand.open()


def test_a_hot_hand_is_not_closed_but_says_how_hot_it_is(emulator: Emulator, hand: InspireHand) -> None:
    emulator.tell(lambda hand: setattr(hand.motors[1], "temperature", 72.0))
    eventually(lambda: "ring: too hot" in told(hand).fault)
    assert told(hand).temperature == 72.0
    with raises(DeviceError, "device.hand_over_temperature"):
        hand.close()


def test_its_state_can_be_asked_at_100_hz_while_it_closes(emulator: Emulator, hand: InspireHand) -> None:
    emulator.tell(lambda hand: hand.hold(HANDLE))
    with ThreadPoolExecutor() as pool:
        closing = pool.submit(hand.close)
        ages, q = [], []
        while not closing.done():
            state = hand.state(max_age=0.5)
            ages.append(HostClock().now() - state.joints.stamp)
            q.append(state.joints.q)
            time.sleep(0.01)
        closing.result()
    assert len(ages) > 50
    assert np.median(ages) < 0.03
    assert q[-1][0] - q[0][0] > 0.5


def test_one_motion_at_a_time_and_none_outside_of_its_block(emulator: Emulator, model: HandModel) -> None:
    hand = InspireHand(model, emulator.port, HostClock())
    for use in (hand.state, hand.open, hand.close, hand.clear_faults):
        with raises(DeviceError, "device.closed"):
            use()
    with hand, ThreadPoolExecutor() as pool:
        closing = pool.submit(hand.close)
        eventually(lambda: emulator.angles[0] < 900)
        with raises(DeviceError, "device.busy"):
            hand.open()
        closing.result()
    for use in (hand.state, hand.open, hand.close, hand.clear_faults):
        with raises(DeviceError, "device.closed"):
            use()
    hand.stop()
    with hand:
        assert hand.state().joints.stamp > 0


def test_an_unplugged_cable_is_told_within_50_ms(emulator: Emulator, hand: InspireHand) -> None:
    hand.state()
    emulator.unplug()
    began = time.monotonic()
    with raises(NoAnswerError, "no_answer.hand_unplugged"):
        while True:
            hand.state()
    assert time.monotonic() - began < 0.05
    with raises(NoAnswerError, "no_answer.hand_unplugged"):
        hand.close()


def test_an_unplugged_cable_ends_a_motion(emulator: Emulator, hand: InspireHand) -> None:
    with ThreadPoolExecutor() as pool:
        closing = pool.submit(hand.close)
        eventually(lambda: emulator.angles[0] < 800)
        emulator.unplug()
        with raises(NoAnswerError, "no_answer.hand_unplugged"):
            closing.result(0.5)


def test_a_silent_hand_has_no_state_until_it_answers_again(emulator: Emulator, hand: InspireHand) -> None:
    emulator.faults.muted = True
    time.sleep(0.5)
    with raises(StaleDataError, "stale_data.hand"):
        hand.state()
    assert hand.state(max_age=5.0) is not None
    with raises(StaleDataError, "stale_data.hand"):
        hand.close()
    with raises(NoAnswerError, "no_answer.hand_silent"):
        hand.clear_faults()
    emulator.faults.muted = False
    time.sleep(0.3)
    assert hand.state() is not None


def test_a_hand_that_answers_and_takes_no_command_says_so_until_it_takes_one(
    emulator: Emulator, hand: InspireHand
) -> None:
    """Its grip would go slack unseen: state is told on."""
    emulator.tell(lambda hand: hand.hold(HANDLE))
    hand.close()
    happen(emulator, "deaf")
    emulator.tell(lambda hand: hand.slip(25))  # takes half of the force, and is no slip yet
    eventually(lambda: hand.state(max_age=2.0).fault == UNTAKEN)
    assert hand.state(max_age=2.0).holding
    with raises(NoAnswerError, "no_answer.hand_write") as caught:
        hand.open()
    assert "answers questions" in str(caught.value)
    happen(emulator, "acknowledge")
    hand.open()
    assert hand.state(max_age=2.0).fault == ""


def test_ports_that_cannot_be_opened_and_hands_that_are_not_there(emulator: Emulator, model: HandModel) -> None:
    with raises(NoAnswerError, "no_answer.hand_port"), InspireHand(model, "/dev/no_such_port", HostClock()):
        pass
    with raises(NoAnswerError, "no_answer.hand_silent"), InspireHand(model, emulator.port, HostClock(), hand_id=2):
        pass
    with (
        InspireHand(model, emulator.port, HostClock()),
        raises(NoAnswerError, "no_answer.hand_port"),
        InspireHand(model, emulator.port, HostClock()),
    ):
        pass
