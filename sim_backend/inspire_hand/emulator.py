"""The emulated RH56 on a pseudo-terminal."""

from __future__ import annotations

import time

from toolee_robot.sim_backend.hand_wire import Frame, HandEmulator, LineFaults
from toolee_robot.sim_backend.inspire_hand.hand import NAMES, Hand
from toolee_robot.sim_backend.inspire_hand.requests import RequestParser, foreign

TURNAROUND = 0.0041
"""Time that the hand takes for a reply [s]: with the 29 bytes of a read of 12 bytes, the measured 6.6 ms."""
BYTE_TIME = 10.0 / 115200.0
"""Time of a byte on the line [s]."""


class InspireEmulator(HandEmulator[Hand]):
    """An Inspire RH56 that a driver finds at `port`.

    Args:
        number: The hand's number on the line.
        seed: Seed of the line's noise.
        pace: Rate of the motors' time relative to the host's; the line keeps to the host's.
    """

    label = "Inspire RH56"
    motors = NAMES
    events = "heat MOTOR DEGREES, jam MOTOR, free MOTOR"

    def __init__(self, number: int = 1, seed: int = 0, pace: float = 1.0) -> None:
        hand = Hand(lambda: pace * time.monotonic(), number)
        super().__init__(hand, LineFaults(foreign, seed), TURNAROUND, BYTE_TIME, pace)
        self._parser = RequestParser(number)

    def hold(self, at: float | None) -> None:
        """Put something into the hand, met by fingers and thumb at this angle [counts]; None: take it out."""
        self.tell(lambda hand: hand.hold(at))

    def slip(self, way: float) -> None:
        """Let what the hand holds give way by this much [counts]."""
        self.tell(lambda hand: hand.slip(way))

    def met(self, finger: str) -> None:
        """Let a finger meet something where it is now."""
        name = "thumb_bend" if finger == "thumb" else finger
        if name not in NAMES:
            return  # the palm, which has no motor

        def feel(hand: Hand) -> None:
            hand.run()
            motor = hand.motors[NAMES.index(name)]
            if motor.met_at is None:
                motor.met_at = motor.position

        self.tell(feel)

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """Let a motor get hot, jam, or come free.

        Args:
            event: Its first word, one of `events`.
            motor: The motor that it names; None without one.
            words: What follows.

        Raises:
            ValueError: There is no such event, or a word is wrong.
        """
        if motor is None or event not in ("heat", "jam", "free") or len(words) != (event == "heat"):
            raise ValueError(event)

        def change(hand: Hand) -> None:
            hand.run()
            if event == "heat":
                hand.motors[motor].temperature = float(words[0])
            else:
                hand.motors[motor].jammed = event == "jam"

        self.tell(change)

    def _angles(self, hand: Hand) -> tuple[float, ...]:
        return hand.angles

    def _answer(self, data: bytes) -> list[Frame]:
        frames = [frame for request in self._parser.take(data) for frame in self._hand.answer(request)]
        self._parser.number = self._hand.number
        return frames
