"""The serial line to one hand: a command every few milliseconds, and the replies to them."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from typing import Self

from toolee_robot.errors import NoAnswerError, ProtocolError
from toolee_robot.hal import Clock
from toolee_robot.hardware.hands.ability.frames import (
    FrameReader,
    Header,
    position_command,
    read_command,
)
from toolee_robot.hardware.hands.ability.replies import Reply, decode
from toolee_robot.hardware.hands.serial.port import LineCounts, SerialPort

BAUD_RATE = 460800
"""As delivered (ICD 3.1.2.1)."""
ANSWER_TIME = 0.03
"""Time for a reply [s]: 2 ms on the wire, and a USB adapter may keep it back for 16 ms."""
ATTEMPTS = 5
"""Attempts to find the hand."""
EXPIRES = 0.25
"""Time after which a reply does not come any more [s]."""


@dataclass(frozen=True)
class Answer:
    """A reply, and when its command went out at the earliest."""

    stamp: float
    """Time [s]."""
    reply: Reply
    """The reply."""


class HandLine:
    """The hand on a serial port; one thread may use it.

    Every command is answered, and the answer is its acknowledgement: a damaged command gets none. Replies come in the
    order of the commands, but do not say which they answer. So two kinds of commands take turns, and a reply counts for
    the oldest command of its kind that is still without: a late one is never taken for newer than it is.

    Args:
        port: The serial port.
        address: The hand's address.
        clock: The station's clock.

    Attributes:
        counts: What happened on the line.

    Raises:
        NoAnswerError: The port cannot be opened.
    """

    def __init__(self, port: str, address: int, clock: Clock) -> None:
        self.counts = LineCounts()
        self._address, self._clock = address, clock
        self._reader = FrameReader()
        self._unanswered: deque[tuple[Header, float]] = deque()
        self._turn, self._known = False, False
        self._port = SerialPort(port, BAUD_RATE, ANSWER_TIME)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the port; nothing is said to the hand, which leaves the API mode 0.3 s later."""
        self._port.close()

    def find(self) -> Answer:
        """Ask whether the hand is there, with some attempts.

        Returns:
            Its reply.

        Raises:
            NoAnswerError: None came in time, or the port is gone.
            ProtocolError: It says what no Ability Hand says.
        """
        for _ in range(ATTEMPTS - 1):
            try:
                return self.exchange(None)
            except NoAnswerError as error:
                if error.code != "no_answer.hand_silent":
                    raise
        return self.exchange(None)

    def exchange(self, degrees: tuple[float, ...] | None) -> Answer:
        """Send a command, and wait for its reply; another one's may do.

        Args:
            degrees: Positions of the six motors [deg]; None: only ask.

        Returns:
            The reply.

        Raises:
            NoAnswerError: None came in time, or the port is gone.
            ProtocolError: It says what no Ability Hand says.
        """
        self._turn = not self._turn
        if degrees is None:
            header = Header.READ_CURRENT if self._turn else Header.READ_VELOCITY
            command = read_command(self._address, header)
        else:
            header = Header.POSITION_CURRENT if self._turn else Header.POSITION_VELOCITY
            command = position_command(self._address, header, degrees)
        self.counts.requests += 1
        now = self._clock.now()
        while self._unanswered and now - self._unanswered[0][1] > EXPIRES:
            self._unanswered.popleft()
        self._unanswered.append((header, now))
        answer = None
        if self._port.send(command):
            end = time.monotonic() + ANSWER_TIME
            while answer is None and time.monotonic() < end:
                answer = self._take(self._port.receive())
        if answer is None:
            self.counts.unanswered += 1
            message = (
                f"no hand {self._address} answers on {self._port.path}: check its power, its two wires, that its UART "
                "and both stuffings are on (We16, We46, We47), and its address"
            )
            raise NoAnswerError(message, code="no_answer.hand_silent")
        return answer

    def _take(self, data: bytes) -> Answer | None:
        """The newest answer in what has come."""
        answer = None
        for frame in self._reader.feed(data):
            try:
                reply = decode(frame)
            except ProtocolError:
                if not self._known:
                    raise
                self._reader.corrupt += 1
                continue
            if reply is not None:
                self._known = True
                answer = self._attribute(reply) or answer
        self.counts.corrupt = self._reader.corrupt
        return answer

    def _attribute(self, reply: Reply) -> Answer | None:
        """Find the command; None for a reply that nobody waits for, such as one that comes twice."""
        headers = [header for header, _ in self._unanswered]
        if reply.header not in headers:
            return None
        for _ in range(headers.index(reply.header) + 1):
            _, stamp = self._unanswered.popleft()
        return Answer(stamp, reply)
