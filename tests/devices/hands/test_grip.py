"""What a closed hand holds, by its readings: a slip, a finger that has lost the handle, and a lost tool."""

from __future__ import annotations

import numpy as np
import pytest

from toolee_robot.devices.hands.grip import PRESS_PERIOD_S, WINDOW_S, Grip, GripRule, Reading

RULE = GripRule((0, 1, 2, 3), 4, touches=1.0, shut=80.0, slipped=5.0, unit="deg")
AT, FORCE = 50.0, 6.0


class Hand:
    """Five fingers on a handle, read every 10 ms."""

    def __init__(self) -> None:
        self.closures, self.forces = np.full(5, AT), np.full(5, FORCE)
        self.grip, self._number = Grip(RULE), 0
        self.read(WINDOW_S)
        assert self.grip.begin(self._reading())

    def read(self, duration: float) -> set[int]:
        """Let time pass; return the fingers that are to be closed further."""
        pressed: set[int] = set()
        for _ in range(round(duration / 0.01)):
            self._number += 1
            pressed.update(self.grip.follow(self._reading()))
        return pressed

    def _reading(self) -> Reading[None]:
        return Reading(0.01 * self._number, self.closures.copy(), self.forces.copy(), None)


@pytest.fixture
def hand() -> Hand:
    return Hand()


def test_a_grip_that_stays_has_not_slipped(hand: Hand) -> None:
    hand.closures += RULE.slipped - 0.1
    assert not hand.read(1.0)
    assert hand.grip.holding
    assert hand.grip.slipped == ""


def test_fingers_that_follow_a_handle_further_than_a_little_tell_a_slip(hand: Hand) -> None:
    hand.closures += RULE.slipped + 1.0
    hand.read(0.01)
    assert "6 deg" in hand.grip.slipped
    assert hand.grip.holding


@pytest.mark.parametrize("finger", range(5))
def test_one_finger_that_has_lost_the_handle_tells_a_slip_while_the_others_hold(hand: Hand, finger: int) -> None:
    hand.forces[finger], hand.closures[finger] = 0.0, AT + RULE.slipped + 1.0
    hand.read(WINDOW_S + 0.02)
    if finger == RULE.thumb:
        assert not hand.grip.holding, "there is no grip without the thumb"
    else:
        assert hand.grip.holding
        assert hand.grip.slipped


def test_a_tool_that_is_gone_is_lost_and_has_not_slipped(hand: Hand) -> None:
    hand.forces[:], hand.closures[:] = 0.0, AT + RULE.slipped + 1.0
    hand.read(WINDOW_S + 0.02)
    assert not hand.grip.holding
    assert hand.grip.slipped == ""


def test_a_finger_whose_force_has_fallen_is_closed_further_but_not_with_every_reading(hand: Hand) -> None:
    hand.forces[1] = 2.0
    assert hand.read(WINDOW_S + 0.02) == {1}
    assert not hand.read(0.5 * PRESS_PERIOD_S)
    assert hand.read(PRESS_PERIOD_S) == {1}
