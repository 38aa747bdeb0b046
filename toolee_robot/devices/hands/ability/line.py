"""The serial line to one hand: a command every few milliseconds, and the replies to them."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from typing import Self

from toolee_robot.devices.hands.ability.frames import (
    FrameReader,
    Header,
    position_command,
    read_command,
)
from toolee_robot.devices.hands.ability.replies import Reply, decode
from toolee_robot.devices.hands.wire.counts import LineCounts
from toolee_robot.devices.hands.wire.port import SerialPort
from toolee_robot.errors import NoAnswerError, ProtocolError
from toolee_robot.hal import Clock

BAUD_RATE = 460800
"""As delivered (ICD 3.1.2.1)."""
ANSWER_TIME = 0.03
"""Time for a reply [s]: 2 ms on the wire, and a USB adapter may keep it back for 16 ms."""
ATTEMPTS = 5
"""Attempts to find the hand."""
EXPIRES = 0.25
"""Time after which a reply does not come any more [s of the host's time]."""


@dataclass(frozen=True)
class Answer:
    """A reply, and when its command went out at the earliest."""

    stamp: float
    """Time [s]."""
    reply: Reply
    """The reply."""


class HandLine:
    """The hand on a serial port; one thread may use it.

    Every command is answered, and the answer is its acknowledgement: a damaged command gets none. A reply does not say
    which command it answers, but its kind, and there are two kinds of commands. So a late reply is never taken for
    newer than it is: while that to a command of one kind may still come, the other kind is used, and if both may, a
    reply counts as the one to the oldest, and for nothing if a newer one was there already.

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
        self._doubted: dict[Header, deque[tuple[float, float]]] = {header: deque() for header in Header}
        self._turn, self._known = False, False
        self._newest = -math.inf
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
        sent, now = time.monotonic(), self._clock.now()
        header = self._kind(degrees is None, sent)
        doubted = self._doubted[header]
        stamp = doubted[0][1] if doubted else now
        command = (
            read_command(self._address, header) if degrees is None else position_command(self._address, header, degrees)
        )
        self.counts.requests += 1
        self._port.drop_received()
        if self._port.send(command):
            end = time.monotonic() + ANSWER_TIME
            while time.monotonic() < end:
                reply = self._take(self._port.receive(), header)
                if reply is not None and stamp >= self._newest:
                    self._newest = stamp
                    return Answer(stamp, reply)
        doubted.append((sent, now))
        self.counts.unanswered += 1
        message = (
            f"no hand {self._address} answers on {self._port.path}: check its power, its two wires, that its UART "
            "and both stuffings are on (We16, We46, We47), its address, and that hand.port is not another device's"
        )
        raise NoAnswerError(message, code="no_answer.hand_silent")

    def _kind(self, reads: bool, sent: float) -> Header:
        """The kind of the next command: the two in turn, but for one to which a reply may still come."""
        for doubted in self._doubted.values():
            while doubted and sent - doubted[0][0] > EXPIRES:
                doubted.popleft()
        kinds = (
            (Header.READ_CURRENT, Header.READ_VELOCITY)
            if reads
            else (Header.POSITION_CURRENT, Header.POSITION_VELOCITY)
        )
        self._turn = not self._turn
        first, second = kinds if self._turn else kinds[::-1]
        since = [self._doubted[kind][0][0] if self._doubted[kind] else math.inf for kind in (first, second)]
        return first if since[0] >= since[1] else second

    def _take(self, data: bytes, header: Header) -> Reply | None:
        """The first reply of a kind in what has come."""
        found = None
        for frame in self._reader.feed(data):
            try:
                reply = decode(frame)
            except ProtocolError:
                if not self._known:
                    raise
                self._reader.corrupt += 1
                continue
            if reply is not None and reply.header is header and found is None:
                self._known, found = True, reply
        self.counts.corrupt = self._reader.corrupt
        return found
