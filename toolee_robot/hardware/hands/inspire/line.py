"""The serial line to one hand: a request, its reply, a bounded number of attempts, and typed errors."""

from __future__ import annotations

import time
from itertools import cycle
from typing import Self

from toolee_robot.errors import DeviceError, NoAnswerError
from toolee_robot.hardware.hands.inspire.frames import WRITTEN, ReplySearch, Request, read_request, write_request
from toolee_robot.hardware.hands.inspire.registers import ANGLE_ACT
from toolee_robot.hardware.hands.wire.counts import LineCounts
from toolee_robot.hardware.hands.wire.port import SerialPort

BAUD_RATE = 115200
ANSWER_TIME = 0.04
"""Time for a reply [s]: 6.6 ms were measured for a read of 12 bytes, and a USB adapter may keep it back for 16 ms."""
ATTEMPTS = 3
_BARRIERS = range(1, 12)


class HandLine:
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

    def __init__(self, port: str, hand_id: int) -> None:
        self.counts = LineCounts()
        self._hand_id = hand_id
        self._barrier_lengths = cycle(_BARRIERS)
        self._port = SerialPort(port, BAUD_RATE, ANSWER_TIME)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the port; nothing is said to the hand."""
        self._port.close()

    def read(self, register: int, count: int) -> bytes:
        """Read bytes, with some attempts.

        Args:
            register: Address of the first.
            count: Number of bytes.

        Returns:
            The bytes.

        Raises:
            NoAnswerError: The hand does not answer, or the port is gone.
        """
        request = read_request(self._hand_id, register, count)
        for attempt in range(ATTEMPTS):
            if attempt and not self._drop_older():
                continue
            payload = self._ask(request)
            if payload is not None:
                return payload
        raise self._silent(request)

    def write(self, register: int, data: bytes) -> None:
        """Write bytes, and see them acknowledged, or else read them back, with some attempts.

        Args:
            register: Address of the first.
            data: The bytes.

        Raises:
            NoAnswerError: The hand does not answer, or the port is gone: whether it has taken the bytes is not known.
            DeviceError: It refuses them.
        """
        request = write_request(self._hand_id, register, data)
        read_back = read_request(self._hand_id, register, len(data))
        for attempt in range(ATTEMPTS):
            if attempt:
                if not self._drop_older():
                    continue
                if self._ask(read_back) == data:
                    return
            result = self._ask(request)
            if result == WRITTEN:
                return
            if result is not None:
                message = f"the hand refuses to take {data.hex(' ')} for register {register}: is it another model?"
                raise DeviceError(message, code="device.hand_refuses")
        raise self._silent(request)

    def _ask(self, request: Request) -> bytes | None:
        """One attempt; None without a usable reply in time."""
        self.counts.requests += 1
        payload = self._exchange(request)
        self.counts.unanswered += payload is None
        return payload

    def _exchange(self, request: Request) -> bytes | None:
        search = ReplySearch(request)
        try:
            self._port.drop_received()
            if not self._port.send(request.encoded):
                return None
            end = time.monotonic() + ANSWER_TIME
            while time.monotonic() < end:
                payload = search.feed(self._port.receive())
                if payload is not None:
                    return payload
                if search.corrupt:  # there will be no other
                    break
            return None
        finally:
            self.counts.corrupt += search.corrupt

    def _drop_older(self) -> bool:
        """Wait until every reply to an older request has come, or must have; whether the hand answered."""
        return self._ask(read_request(self._hand_id, ANGLE_ACT, next(self._barrier_lengths))) is not None

    def _silent(self, request: Request) -> NoAnswerError:
        message = (
            f"no hand {self._hand_id} answers on {self._port.path} (register {request.register}, {ATTEMPTS} attempts): "
            "check its power, the two wires of RS-485, and its number"
        )
        return NoAnswerError(message, code="no_answer.hand_silent")
