"""The Ability Hand's driver on the emulated hand, over a pseudo-terminal: grasps, and what goes wrong with them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.devices.hands.ability import AbilityHand
from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.hal import HandState
from toolee_robot.robots import HandModel
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.ability_hand import AbilityEmulator, Hand
from toolee_robot.sim_backend.hand_wire import happen

pytestmark = pytest.mark.realtime(light=True)

HANDLE = 55.0
"""Angle at which the fingers meet a handle [deg]."""


def eventually(condition: Callable[[], bool], within: float = 4.0) -> None:
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def told(hand: AbilityHand) -> HandState:
    """Its state, however busy this machine is."""
    return hand.state(max_age=1.0)


def in_api(emulator: AbilityEmulator) -> bool:
    modes: list[bool] = []
    emulator.tell(lambda hand: modes.append(hand.in_api))
    return modes[0]


def opens_freely(emulator: AbilityEmulator) -> None:
    """Let no finger take its own opening for a collision: such a one stays closed when the API mode ends."""

    def free(hand: Hand) -> None:
        for motor in hand.motors:
            motor.ratchets = 0.0

    emulator.tell(free)


def held(emulator: AbilityEmulator, hand: AbilityHand) -> None:
    emulator.hold(HANDLE)
    hand.close()
    assert told(hand).holding
    assert told(hand).fault == ""


def held_up(hand: AbilityHand, monkeypatch: pytest.MonkeyPatch, duration: float) -> None:
    """Let the driver send nothing for this long [s on the wall clock], once."""
    line = hand._line
    assert line is not None
    exchange, over = line.exchange, threading.Event()

    def hold_up(degrees: tuple[float, ...] | None) -> object:
        if not over.is_set():
            time.sleep(duration)
            over.set()
        return exchange(degrees)

    monkeypatch.setattr(line, "exchange", hold_up)
    assert over.wait(duration + 2.0)
    time.sleep(0.3)


def test_entering_moves_nothing_and_leaves_it_to_whoever_drives_it(
    emulator: AbilityEmulator, hand: AbilityHand
) -> None:
    emulator.tell(lambda hand: setattr(hand.motors[0], "position", 30.0))
    time.sleep(0.2)
    assert not in_api(emulator)
    assert emulator.angles == (30.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert told(hand).joints.q[0] == pytest.approx(np.deg2rad(30.0), abs=1e-3)


def test_it_presses_slowly_keeps_the_api_mode_up_and_lets_go_when_it_opens(
    emulator: AbilityEmulator, hand: AbilityHand
) -> None:
    held(emulator, hand)
    assert all(6.0 < force < 15.0 for force in told(hand).contact_forces.values()), (
        "not what momentum adds at full speed"
    )
    time.sleep(0.7)
    assert in_api(emulator)
    assert told(hand).holding
    hand.open()
    assert not told(hand).holding
    assert max(map(abs, emulator.angles[:5])) < 1.0


def test_the_grip_is_kept_up_although_the_hand_bars_a_finger_that_has_collided(
    emulator: AbilityEmulator, hand: AbilityHand
) -> None:
    held(emulator, hand)
    before = emulator.angles[0]
    emulator.slip(3.0)
    eventually(lambda: min(told(hand).contact_forces.values()) > 6.0 and emulator.angles[0] > before + 0.5)
    assert told(hand).holding
    assert told(hand).fault == "", "a little is no slip"
    emulator.slip(4.0)
    eventually(lambda: "slipped" in told(hand).fault)
    emulator.hold(None)
    began = time.monotonic()
    eventually(lambda: not told(hand).holding)
    assert time.monotonic() - began < 0.4, "a lost tool"
    hand.open()
    assert told(hand).fault == ""


def test_a_stop_freezes_the_fingers_and_keeps_a_grip(emulator: AbilityEmulator, hand: AbilityHand) -> None:
    with ThreadPoolExecutor() as pool:
        closing = pool.submit(hand.close)
        eventually(lambda: emulator.angles[0] > 25.0)
        hand.stop()
        with raises(DeviceError, "device.stopped"):
            closing.result(5.0)
    time.sleep(0.3)
    stands = emulator.angles
    assert stands[0] < 90.0
    time.sleep(0.2)
    np.testing.assert_allclose(emulator.angles, stands, atol=0.1)
    held(emulator, hand)
    hand.stop()
    time.sleep(0.3)
    assert told(hand).holding


def test_a_time_out_keeps_position_and_grip(emulator: AbilityEmulator, hand: AbilityHand) -> None:
    hand.open()
    with raises(DeviceError, "device.timeout"):
        hand.close(timeout=0.4)
    time.sleep(0.3)
    assert 2.0 < emulator.angles[0] < 90.0
    held(emulator, hand)
    with raises(DeviceError, "device.timeout"):
        hand.open(timeout=0.01)
    time.sleep(0.2)
    assert told(hand).holding


def test_heat_is_a_fault_while_it_holds_and_a_grip_alone_is_none(emulator: AbilityEmulator, hand: AbilityHand) -> None:
    held(emulator, hand)
    time.sleep(0.5)
    assert hand.reading(1.0).barred[:5].all(), "the hand says of a gripping finger what it says of a hot one"
    assert told(hand).fault == ""
    emulator.tell(lambda hand: hand.heat(75.0))
    eventually(lambda: told(hand).fault == "too hot")
    assert told(hand).holding
    assert told(hand).temperature is None
    with raises(DeviceError, "device.hand_over_temperature"):
        hand.close()
    emulator.tell(lambda hand: hand.heat(40.0))
    eventually(lambda: told(hand).fault == "")
    assert told(hand).holding


def test_a_finger_that_does_not_move_passes_neither_for_open_nor_for_closed(
    emulator: AbilityEmulator, hand: AbilityHand
) -> None:
    emulator.tell(lambda hand: setattr(hand.motors[1], "jammed", True))
    with raises(DeviceError, "device.hand_stall"):
        hand.close()
    emulator.tell(lambda hand: setattr(hand.motors[2], "jammed", True))
    with raises(DeviceError, "device.hand_blocked"):
        hand.open()


def always_ratchets_twice(hand: Hand) -> None:
    """Going back after a collision is taken for another one: the interface document's false positives."""
    draws = iter([0.0, 0.0])

    class Chance:
        @staticmethod
        def random() -> float:
            return next(draws, 1.0)

    for motor in hand.motors:
        motor.chance = Chance()  # type: ignore[assignment]


def test_it_opens_although_that_is_taken_for_a_collision(emulator: AbilityEmulator, hand: AbilityHand) -> None:
    held(emulator, hand)
    emulator.tell(always_ratchets_twice)
    hand.open()
    assert max(map(abs, emulator.angles[:5])) < 1.0


def test_a_silent_hand_is_told_on_what_it_holds_and_an_error_says_so(
    emulator: AbilityEmulator, hand: AbilityHand
) -> None:
    held(emulator, hand)
    emulator.faults.muted = True
    time.sleep(0.6)
    with raises(StaleDataError, "stale_data.hand"):
        hand.state()
    assert in_api(emulator), "commands go on, whether they are answered or not"
    emulator.faults.muted = False
    eventually(lambda: told(hand).holding)


def test_a_driver_that_was_held_up_does_not_close_again_what_the_hand_may_have_opened(
    emulator: AbilityEmulator, hand: AbilityHand, monkeypatch: pytest.MonkeyPatch
) -> None:
    opens_freely(emulator)
    held(emulator, hand)
    held_up(hand, monkeypatch, 0.6)
    assert "without a command" in told(hand).fault
    assert not told(hand).holding, "the emulated hand has opened meanwhile"
    stands = emulator.angles
    time.sleep(0.3)
    np.testing.assert_allclose(emulator.angles, stands, atol=5.0)
    hand.open()
    assert told(hand).fault == ""


@pytest.mark.nightly  # the station's real-time factor is looked at in every run
def test_a_rehearsal_in_slow_motion_gives_the_driver_its_slower_time(
    model: HandModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    factor = 0.2
    with AbilityEmulator(pace=factor) as emulator, AbilityHand(model, emulator.port, HostClock(factor)) as hand:
        opens_freely(emulator)
        emulator.hold(HANDLE)
        hand.close()
        held_up(hand, monkeypatch, 0.6)
        assert in_api(emulator), "0.12 s have passed for the hand"
        assert told(hand).fault == ""
        assert told(hand).holding
        held_up(hand, monkeypatch, 1.8)
        assert "without a command" in told(hand).fault
        assert max(emulator.angles[:4]) < HANDLE - 2.0, "the emulated hand has opened meanwhile"


def test_an_unplugged_cable_is_told_within_50_ms(emulator: AbilityEmulator, hand: AbilityHand) -> None:
    held(emulator, hand)
    emulator.unplug()
    began = time.monotonic()
    with raises(NoAnswerError, "no_answer.hand_unplugged"):
        while True:
            hand.state(max_age=10.0)
    assert time.monotonic() - began < 0.05
    with raises(NoAnswerError, "no_answer.hand_unplugged"):
        hand.open()


def test_a_hand_without_pads_cannot_tell_what_it_holds_and_is_refused(
    emulator: AbilityEmulator, model: HandModel
) -> None:
    happen(emulator, "pads off")
    with raises(DeviceError, "device.hand_no_pads"), AbilityHand(model, emulator.port, HostClock()):
        pass


def test_nobody_at_that_address(model: HandModel) -> None:
    with (
        AbilityEmulator(address=0x51) as emulator,
        raises(NoAnswerError, "no_answer.hand_silent"),
        AbilityHand(model, emulator.port, HostClock()),
    ):
        pass
    with raises(NoAnswerError, "no_answer.hand_port"), AbilityHand(model, "/dev/no-such-port", HostClock()):
        pass
