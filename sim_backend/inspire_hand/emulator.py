"""The emulated RH56 on a pseudo-terminal."""

from __future__ import annotations

import time

from toolee_robot.sim_backend.hand_wire import Frame, LineFaults, SerialEmulator
from toolee_robot.sim_backend.inspire_hand.hand import NAMES, Hand
from toolee_robot.sim_backend.inspire_hand.requests import RequestParser, foreign

TURNAROUND = 0.0041
"""Time that the hand takes for a reply [s]: with the 29 bytes of a read of 12 bytes, the measured 6.6 ms."""
BYTE_TIME = 10.0 / 115200.0
"""Time of a byte on the line [s]."""


class InspireEmulator(SerialEmulator[Hand]):
    """An Inspire RH56 that a driver finds at `port`.

    Args:
        number: The hand's number on the line.
        seed: Seed of the line's noise.
        pace: Rate of the motors' time relative to the host's; the line keeps to the host's.
    """

    label = "Inspire RH56"
    motors, thumb = NAMES, "thumb_bend"
    events = "heat MOTOR DEGREES, jam MOTOR, free MOTOR"

    def __init__(self, number: int = 1, seed: int = 0, pace: float = 1.0) -> None:
        hand = Hand(lambda: pace * time.monotonic(), number)
        super().__init__(hand, LineFaults(foreign, seed), TURNAROUND, BYTE_TIME, pace)
        self._parser = RequestParser(number)

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

    def _answer(self, data: bytes) -> list[Frame]:
        frames = [frame for request in self._parser.take(data) for frame in self._hand.answer(request)]
        self._parser.number = self._hand.number
        return frames
