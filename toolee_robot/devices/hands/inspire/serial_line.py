"""The RS-485 line to one hand, with the maker's frames."""

from __future__ import annotations

from itertools import cycle

from toolee_robot.devices.hands.inspire.frames import ReplySearch, Request, read_request, write_request
from toolee_robot.devices.hands.inspire.line import ANSWER_TIME, HandLine
from toolee_robot.devices.hands.inspire.registers import ANGLE_ACT
from toolee_robot.devices.hands.wire.port import SerialPort

BAUD_RATE = 115200
_BARRIERS = range(1, 12)


class SerialLine(HandLine[Request]):
    """The hand on a serial port; one thread may use it.

    A reply that comes too late could be taken for that to the next request of the same register. So after a request
    without a reply, a short read goes out whose length was not used lately: once that is answered, whatever is older
    has come, and is dropped.

    Args:
        port: The serial port.
        hand_id: The hand's number on the line.

    Attributes:
        counts: What happened on the line.

    Raises:
        NoAnswerError: The port cannot be opened.
    """

    order, one = "<", b"\x01"
    _look_at = "check its power, the two wires of RS-485"

    def __init__(self, port: str, hand_id: int) -> None:
        super().__init__(SerialPort(port, BAUD_RATE, ANSWER_TIME), hand_id)
        self._barrier_lengths = cycle(_BARRIERS)

    def _reading(self, register: int, count: int) -> Request:
        return read_request(self._hand_id, register, count)

    def _writing(self, register: int, data: bytes) -> Request:
        return write_request(self._hand_id, register, data)

    def _sent(self, request: Request) -> tuple[bytes, ReplySearch]:
        return request.encoded, ReplySearch(request)

    def _recover(self) -> bool:
        """Wait until every reply to an older request has come, or must have; whether the hand answered."""
        return self._ask(self._reading(ANGLE_ACT, next(self._barrier_lengths))) is not None
