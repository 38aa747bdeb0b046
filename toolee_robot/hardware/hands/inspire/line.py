"""The serial line to one hand: a request, its reply, a bounded number of attempts, and typed errors."""

from __future__ import annotations

import termios
import time
from dataclasses import dataclass
from itertools import cycle
from typing import Self

import serial

from toolee_robot.errors import DeviceError, NoAnswerError
from toolee_robot.hardware.hands.inspire.frames import WRITTEN, ReplySearch, Request, read_request, write_request
from toolee_robot.hardware.hands.inspire.registers import ANGLE_ACT

BAUD_RATE = 115200
ANSWER_TIME = 0.04
"""Time for a reply [s]: 6.6 ms were measured for a read of 12 bytes, and a USB adapter may keep it back for 16 ms."""
ATTEMPTS = 3
_READ_TIME = 0.01
_BARRIERS = range(1, 12)


@dataclass
class LineCounts:
    """What happened on the line."""

    requests: int = 0
    """Requests sent, repeated ones included."""
    unanswered: int = 0
    """Requests that nothing usable came back for."""
    corrupt: int = 0
    """Replies that were found damaged."""


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
        self._hand_id, self._port = hand_id, port
        self._barrier_lengths = cycle(_BARRIERS)
        try:
            self._serial = serial.Serial(port, BAUD_RATE, timeout=_READ_TIME, write_timeout=ANSWER_TIME, exclusive=True)
        except (OSError, ValueError, termios.error) as error:  # pyserial's errors are OSErrors
            message = (
                f"cannot open the hand's port {port}: {error}; check hand.port, the cable, your rights to the port"
            )
            raise NoAnswerError(f"{message}, and that no other program uses it", code="no_answer.hand_port") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the port; nothing is said to the hand."""
        self._serial.close()

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
        search = ReplySearch(request)
        self.counts.requests += 1
        try:
            self._serial.reset_input_buffer()
            self._serial.write(request.encoded)
            end = time.monotonic() + ANSWER_TIME
            while time.monotonic() < end:
                payload = search.feed(self._serial.read(max(1, self._serial.in_waiting)))
                if payload is not None:
                    return payload
                if search.corrupt:  # there will be no other
                    break
        except serial.SerialTimeoutException:  # what was sent lies in the host's buffer
            pass
        except (OSError, termios.error, TypeError) as error:  # TypeError: pyserial, of a port that was closed meanwhile
            message = f"the hand's port {self._port} is gone ({error}): plug the cable in, then start again"
            raise NoAnswerError(message, code="no_answer.hand_unplugged") from error
        finally:
            self.counts.corrupt += search.corrupt
        self.counts.unanswered += 1
        return None

    def _drop_older(self) -> bool:
        """Wait until every reply to an older request has come, or must have; whether the hand answered."""
        return self._ask(read_request(self._hand_id, ANGLE_ACT, next(self._barrier_lengths))) is not None

    def _silent(self, request: Request) -> NoAnswerError:
        message = (
            f"no hand {self._hand_id} answers on {self._port} (register {request.register}, {ATTEMPTS} attempts): "
            "check its power, the two wires of RS-485, and its number"
        )
        return NoAnswerError(message, code="no_answer.hand_silent")
