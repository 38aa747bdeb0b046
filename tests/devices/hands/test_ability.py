"""The Ability Hand's driver on the emulated hand, over a pseudo-terminal: grasps, and what goes wrong with them."""

from __future__ import annotations

import threading
import time
from contextlib import closing, suppress

import numpy as np
import pytest

from tests.errors import raises
from tests.rigs.wired_hands import eventually, told
from toolee_robot.devices.hands.ability import AbilityHand, AbilityLine, Reply
from toolee_robot.errors import DeviceError, NoAnswerError
from toolee_robot.frames import Array
from toolee_robot.robots import HandModel
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands.ability import AbilityEmulator, Hand
from toolee_robot.sim_backend.hands.kit import LineFault, happen

pytestmark = pytest.mark.realtime(light=True)

HANDLE = 55.0
"""Angle at which the fingers meet a handle [deg]."""


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

    def hold_up(degrees: Array | None) -> object:
        if not over.is_set():
            time.sleep(duration)
            over.set()
        return exchange(degrees)

    monkeypatch.setattr(line, "exchange", hold_up)
    assert over.wait(duration + 2.0)
    time.sleep(0.3)


def test_entering_moves_nothing_and_leaves_it_to_whoever_drives_it(
    ability: AbilityEmulator, ability_hand: AbilityHand
) -> None:
    ability.tell(lambda hand: setattr(hand.motors[0], "position", 30.0))
    time.sleep(0.2)
    assert not in_api(ability)
    assert ability.angles == (30.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert told(ability_hand).joints.q[0] == pytest.approx(np.deg2rad(30.0), abs=1e-3)


@pytest.mark.nightly
def test_it_presses_slowly_keeps_the_api_mode_up_and_lets_go_when_it_opens(
    ability: AbilityEmulator, ability_hand: AbilityHand
) -> None:
    held(ability, ability_hand)
    assert all(6.0 < force < 15.0 for force in told(ability_hand).contact_forces.values()), (
        "not what momentum adds at full speed"
    )
    time.sleep(0.7)
    assert in_api(ability)
    assert told(ability_hand).holding
    ability_hand.open()
    assert not told(ability_hand).holding
    assert max(map(abs, ability.angles[:5])) < 1.0


@pytest.mark.nightly
def test_the_grip_is_kept_up_although_the_hand_bars_a_finger_that_has_collided(
    ability: AbilityEmulator, ability_hand: AbilityHand
) -> None:
    held(ability, ability_hand)
    before = ability.angles[0]
    ability.slip(3.0)
    eventually(lambda: min(told(ability_hand).contact_forces.values()) > 6.0 and ability.angles[0] > before + 0.5)
    assert told(ability_hand).holding
    assert told(ability_hand).fault == "", "a little is no slip"
    ability.slip(4.0)
    eventually(lambda: "slipped" in told(ability_hand).fault)
    ability.hold(None)
    began = time.monotonic()
    eventually(lambda: not told(ability_hand).holding)
    assert time.monotonic() - began < 0.4, "a lost tool"
    ability_hand.open()
    assert told(ability_hand).fault == ""


def test_heat_is_a_fault_while_it_holds_and_a_grip_alone_is_none(
    ability: AbilityEmulator, ability_hand: AbilityHand
) -> None:
    held(ability, ability_hand)
    time.sleep(0.5)
    assert ability_hand.reading(1.0).said[:5].all(), "the hand says of a gripping finger what it says of a hot one"
    assert told(ability_hand).fault == ""
    ability.tell(lambda hand: hand.heat(75.0))
    eventually(lambda: told(ability_hand).fault == "too hot")
    assert told(ability_hand).holding
    assert told(ability_hand).temperature is None
    with raises(DeviceError, "device.hand_over_temperature"):
        ability_hand.close()
    ability.tell(lambda hand: hand.heat(40.0))
    eventually(lambda: told(ability_hand).fault == "")
    assert told(ability_hand).holding


def always_ratchets_twice(hand: Hand) -> None:
    """Going back after a collision is taken for another one: the interface document's false positives."""
    draws = iter([0.0, 0.0])

    class Chance:
        @staticmethod
        def random() -> float:
            return next(draws, 1.0)

    for motor in hand.motors:
        motor.chance = Chance()  # type: ignore[assignment]


@pytest.mark.nightly
def test_it_opens_although_that_is_taken_for_a_collision(ability: AbilityEmulator, ability_hand: AbilityHand) -> None:
    held(ability, ability_hand)
    ability.tell(always_ratchets_twice)
    ability_hand.open()
    assert max(map(abs, ability.angles[:5])) < 1.0


def test_a_driver_that_was_held_up_does_not_close_again_what_the_hand_may_have_opened(
    ability: AbilityEmulator, ability_hand: AbilityHand, monkeypatch: pytest.MonkeyPatch
) -> None:
    opens_freely(ability)
    held(ability, ability_hand)
    held_up(ability_hand, monkeypatch, 0.6)
    assert "without a command" in told(ability_hand).fault
    assert not told(ability_hand).holding, "the emulated hand has opened meanwhile"
    stands = ability.angles
    time.sleep(0.3)
    np.testing.assert_allclose(ability.angles, stands, atol=5.0)
    ability_hand.open()
    assert told(ability_hand).fault == ""


@pytest.mark.nightly  # the station's real-time factor is looked at in every run
def test_a_rehearsal_in_slow_motion_gives_the_driver_its_slower_time(
    ability_model: HandModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    factor = 0.2
    with AbilityEmulator(pace=factor) as emulator, AbilityHand(ability_model, emulator.port, HostClock(factor)) as hand:
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


def test_a_hand_without_pads_cannot_tell_what_it_holds_and_is_refused(
    ability: AbilityEmulator, ability_model: HandModel
) -> None:
    happen(ability, "pads off")
    with raises(DeviceError, "device.hand_no_pads"), AbilityHand(ability_model, ability.port, HostClock()):
        pass


def test_nobody_at_that_address(ability_model: HandModel) -> None:
    with (
        AbilityEmulator(address=0x51) as emulator,
        raises(NoAnswerError, "no_answer.hand_silent"),
        AbilityHand(ability_model, emulator.port, HostClock()),
    ):
        pass
    with (
        raises(NoAnswerError, says="cannot open the hand's port"),
        AbilityHand(ability_model, "/dev/no-such-port", HostClock()),
    ):
        pass


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
