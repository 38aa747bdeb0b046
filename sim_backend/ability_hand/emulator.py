"""The emulated Ability Hand on a pseudo-terminal."""

from __future__ import annotations

from toolee_robot.robots.hands.ability import joints_of_closures
from toolee_robot.sim_backend.ability_hand.hand import NAMES, Hand
from toolee_robot.sim_backend.ability_hand.messages import MessageParser, foreign
from toolee_robot.sim_backend.hand_wire import Frame, HandTime, LineEmulator, LineFaults, PseudoTerminal

TURNAROUND = 0.001
"""Time that the hand takes for a reply [s]: assumed; the maker's client asks 500 times a second."""
BYTE_TIME = 10.0 / 460800.0
"""Time of a byte on the line [s]."""


class AbilityEmulator(LineEmulator[Hand]):
    """A PSYONIC Ability Hand that a driver finds at `port`.

    Args:
        address: The hand's address on the line.
        seed: Seed of noise and chance.
        pace: Rate of the hand's time relative to the host's, in which its API mode ends, too; the line keeps to the
            host's.
    """

    label = "PSYONIC Ability Hand"
    motors, thumb = NAMES, "thumb_flexor"
    joints = staticmethod(joints_of_closures)
    events = "heat MOTOR DEGREES, heat DEGREES, jam MOTOR, free MOTOR, pads off, pads on"

    def __init__(self, address: int = 0x50, seed: int = 0, pace: float = 1.0) -> None:
        self.time = HandTime(pace)
        hand = Hand(self.time, seed)
        super().__init__(hand, PseudoTerminal(), LineFaults(foreign, seed), TURNAROUND, BYTE_TIME, pace)
        self._parser = MessageParser(address)

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """Let a motor or the palm get hot, let one jam or come free, or take the pads away.

        Args:
            event: Its first word, one of `events`.
            motor: The motor that it names; None without one.
            words: What follows.

        Raises:
            ValueError: There is no such event, or a word is wrong.
        """
        if event == "heat" and len(words) == 1:
            degrees = float(words[0])
            self.tell(lambda hand: hand.heat(degrees) if motor is None else _heat(hand, motor, degrees))
        elif event in ("jam", "free") and motor is not None and not words:
            self.tell(lambda hand: _jam(hand, motor, event == "jam"))
        elif event == "pads" and motor is None and words in (("on",), ("off",)):
            self.tell(lambda hand: setattr(hand, "has_pads", words == ("on",)))
        else:
            raise ValueError(event)

    def _answer(self, data: bytes) -> list[Frame]:
        return [frame for message in self._parser.take(data) for frame in self._hand.answer(message)]


def _heat(hand: Hand, motor: int, degrees: float) -> None:
    hand.run()
    hand.motors[motor].temperature = degrees


def _jam(hand: Hand, motor: int, jammed: bool) -> None:
    hand.run()
    hand.motors[motor].jammed = jammed
