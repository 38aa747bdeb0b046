"""The Modbus-TCP connection to one hand."""

from __future__ import annotations

import time

from toolee_robot.devices.hands.inspire.line import ANSWER_TIME, HandLine
from toolee_robot.devices.hands.inspire.modbus import ReplySearch, Request, read_request, write_request
from toolee_robot.devices.hands.inspire.registers import ANGLE_ACT
from toolee_robot.devices.hands.inspire.tcp_port import TcpPort
from toolee_robot.errors import NoAnswerError

SHIFTS = (0, -1, 1)
"""By how much a hand may shift the transaction identifier in its replies: one was seen to be off by one (package
inspire_rh56dftp 0.1.0, "Modbus protocol quirks"), others send it back as they got it."""
GRACE = 0.35
"""Time after which another connection is tried [s]: a hand was seen to drop one that was made less than 0.3 s after the
last one had ended (ibid.)."""
_PROBES = range(2, 26, 2)
"""Bytes that the first requests ask for, each another number of them; nothing moves yet, so that there is time."""


class ModbusLine(HandLine[Request]):
    """The hand on Modbus-TCP; one thread may use it.

    Every request has a transaction identifier of its own, repeated ones too, so that a late or doubled reply is never
    taken for another. How the hand sends it back is learnt from its first replies, whose lengths tell them apart.

    The registers' addresses are those of the serial line and count bytes; a Modbus register holds the two bytes from
    its address on, a number in big-endian order, of two single bytes the first one in the high byte.

    Args:
        port: `tcp://HOST:PORT`.
        hand_id: The hand's unit identifier.

    Attributes:
        counts: What happened on the line.

    Raises:
        NoAnswerError: Nobody can be connected to, or no hand answers.
    """

    order, one = ">", b"\x00\x01"
    _look_at = "check its power, its cable"

    def __init__(self, port: str, hand_id: int) -> None:
        super().__init__(TcpPort(port, ANSWER_TIME), hand_id)
        self._transaction = 0
        self._shifts: tuple[int, ...] = SHIFTS
        try:
            try:
                self._learn_shift()
            except NoAnswerError as error:
                if error.code != "no_answer.hand_unplugged":
                    raise
                self._connect_again(port)
        except BaseException:
            self.close()
            raise

    def _connect_again(self, port: str) -> None:
        self.close()
        time.sleep(GRACE)
        self._port = TcpPort(port, ANSWER_TIME)
        try:
            self._learn_shift()
        except NoAnswerError as error:
            if error.code != "no_answer.hand_unplugged":
                raise
            message = f"the hand at {port} ends every connection at once: does another program use it?"
            raise NoAnswerError(message, code="no_answer.hand_port") from error

    def _learn_shift(self) -> None:
        """Wait for two replies in a row that shift the transaction identifier alike."""
        before = None
        for size in _PROBES:
            request = self._reading(ANGLE_ACT, size)
            search = ReplySearch(request, self._shifts)
            self.counts.requests += 1
            if self._exchange(request.encoded, search) is None:
                self.counts.unanswered += 1
                continue
            if search.shift == before:
                self._shifts = (search.shift,)
                return
            before = search.shift
        raise self._silent(ANGLE_ACT, len(_PROBES))

    def _reading(self, register: int, count: int) -> Request:
        return read_request(self._next(), self._hand_id, register, count)

    def _writing(self, register: int, data: bytes) -> Request:
        return write_request(self._next(), self._hand_id, register, data)

    def _next(self) -> int:
        self._transaction = (self._transaction + 1) & 0xFFFF
        return self._transaction

    def _sent(self, request: Request) -> tuple[bytes, ReplySearch]:
        return request.encoded, ReplySearch(request, self._shifts)

    def _recover(self) -> bool:
        return True  # the next request has another transaction identifier
