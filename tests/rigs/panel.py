"""A door and a hold-to-run switch wired to digital inputs, and somebody who operates them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from toolee_robot.devices.person import CONFIRM, PERIOD
from toolee_robot.errors import StaleDataError
from toolee_robot.station import PersonConfig
from toolee_robot.tasks.common.motions import HOLD_SWITCH

TWO_CONTACTS = PersonConfig(door_closed_input=0, door_open_input=1, hold_to_run_input=2, hold_to_run_released_input=3)
"""Door and switch have two complementary contacts each."""
ONE_CONTACT = PersonConfig(
    door_closed_input=0, door_open_input=None, hold_to_run_input=2, hold_to_run_released_input=None
)
"""Door and switch have one contact each."""
DOOR_CLOSED, SWITCH_HELD, ALL = 0b0001, 0b0100, 0b1111
"""Bits of the inputs."""


class Panel:
    """The wiring."""

    def __init__(self) -> None:
        self.closed = self.held = self.dead = False
        self.high = self.low = self.reads = 0

    def read(self, max_age: float) -> int:
        """Read the inputs, as `DigitalInputPerson` asks for them."""
        self.reads += 1
        if self.dead:
            raise StaleDataError(f"no reading for {max_age} s: look at the link")
        bits = self.closed << 0 | (not self.closed) << 1 | self.held << 2 | (not self.held) << 3
        return (bits | self.high) & ~self.low

    def press(self) -> None:
        """Press the switch and release it, each for as long as a reader of the inputs takes to be sure."""
        self._stay(0.08)
        self.held = True
        self._stay(0.12)
        self.held = False

    def _stay(self, duration: float) -> None:
        """Leave all as it is for this time [s], and for as many readings as are due in it, at most for two seconds."""
        last, began = self.reads + round(duration / PERIOD), time.monotonic()
        while (passed := time.monotonic() - began) < duration or (self.reads < last and passed < 2.0):
            time.sleep(PERIOD)

    def step_back(self) -> None:
        """Leave, close the door, and confirm it."""
        self.closed = True
        self.press()

    def hold(self) -> None:
        """Release the switch and hold it from then on."""
        self.held = False
        self._stay(0.1)
        self.held = True

    def hand_over(self) -> None:
        """Enter, with the switch out of the hand, and confirm."""
        self.held = self.closed = False
        self.press()


class Operator:
    """Somebody who does what the prompts say, a moment later."""

    def __init__(self, panel: Panel) -> None:
        self._panel = panel

    def tell(self, prompt: str) -> None:
        """Do what a prompt says."""
        if prompt == HOLD_SWITCH:
            act = self._panel.hold
        elif "close the door" in prompt:
            act = self._panel.step_back
        elif prompt.startswith("Put the hammer"):
            act = self._panel.hand_over
        elif prompt.endswith(CONFIRM):
            act = self._panel.press
        else:
            return
        later(act)


def later(act: Callable[[], None], delay: float = 0.0) -> None:
    """Do something while the program waits."""
    threading.Timer(delay, act).start()
