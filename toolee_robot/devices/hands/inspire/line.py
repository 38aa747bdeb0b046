"""The line to one hand, whatever the wire: a request, its reply, a bounded number of attempts, and typed errors."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Generic, Protocol, Self, TypeVar

from toolee_robot.devices.hands.inspire.frames import WRITTEN
from toolee_robot.devices.hands.wire.counts import LineCounts
from toolee_robot.errors import DeviceError, NoAnswerError

ANSWER_TIME = 0.04
"""Time for a reply [s]: 6.6 ms were measured for a read of 12 bytes on RS-485, and a USB adapter may keep it back for
16 ms."""
ATTEMPTS = 3


class Port(Protocol):
    """What the bytes go through; see `SerialPort`."""

    path: str

    def close(self) -> None:
        """Release it."""

    def send(self, data: bytes) -> bool:
        """Send bytes; whether they went out in time."""

    def receive(self) -> bytes:
        """Return what has come, after a short wait for the first byte."""

    def drop_received(self) -> None:
        """Forget what has come."""


class Search(Protocol):
    """Looks for the reply to one request in the bytes that arrive."""

    corrupt: int
    """Number of replies to it that were found damaged."""

    def feed(self, data: bytes) -> bytes | None:
        """Take further bytes; return what was read or WRITTEN, None while there is no whole, undamaged reply."""

    @property
    def over(self) -> bool:
        """Whether no other reply will come."""

    @property
    def refusal(self) -> str:
        """What the hand refuses for good, for people; empty if nothing."""


RequestT = TypeVar("RequestT")


class HandLine(ABC, Generic[RequestT]):
    """The hand at the other end of a wire; one thread may use it.

    Args:
        port: What the bytes go through, open.
        hand_id: The hand's number.

    Attributes:
        counts: What happened on the line.
    """

    order: str
    """Order of the bytes of a 16-bit number in what is read and written, as of `struct`."""
    one: bytes
    """What writes 1 to a register of a single byte."""

    def __init__(self, port: Port, hand_id: int) -> None:
        self.counts = LineCounts()
        self._port, self._hand_id = port, hand_id

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
            The bytes; those of a number in `order`.

        Raises:
            NoAnswerError: The hand does not answer, or the port is gone.
            DeviceError: It refuses.
        """
        for attempt in range(ATTEMPTS):
            if attempt and not self._recover():
                continue
            payload = self._ask(self._reading(register, count))
            if payload is not None:
                return payload
        raise self._silent(register)

    def write(self, register: int, data: bytes, *, again: bool = False) -> None:
        """Write bytes, and see them acknowledged, or else read them back, with some attempts.

        Args:
            register: Address of the first.
            data: The bytes; those of a number in `order`.
            again: Whether the hand may hold them already, so that reading them back tells nothing.

        Raises:
            NoAnswerError: The hand does not answer, or the port is gone: whether it has taken the bytes is not known;
                or it answers and has not taken them (`no_answer.hand_write`).
            DeviceError: It refuses them.
        """
        answers = False
        for attempt in range(ATTEMPTS):
            if attempt:
                if not self._recover():
                    continue
                there = self._ask(self._reading(register, len(data)))
                if there == data and not again:
                    return
                answers = answers or there is not None
            result = self._ask(self._writing(register, data))
            if result == WRITTEN:
                return
            if result is not None:
                raise self._refused(f"to take {data.hex(' ')} for register {register}")
        if answers:
            raise NoAnswerError(
                f"the hand {self._hand_id} on {self._port.path} answers questions and does not take what is written "
                f"(register {register}, {ATTEMPTS} attempts): switch it off and on, and end every other program that "
                "commands it",
                code="no_answer.hand_write",
            )
        raise self._silent(register)

    @abstractmethod
    def _reading(self, register: int, count: int) -> RequestT:
        """A request that reads bytes."""

    @abstractmethod
    def _writing(self, register: int, data: bytes) -> RequestT:
        """A request that writes bytes."""

    @abstractmethod
    def _sent(self, request: RequestT) -> tuple[bytes, Search]:
        """The bytes of a request, and the search for its reply."""

    @abstractmethod
    def _recover(self) -> bool:
        """After a request without a reply: make sure that a late one cannot be taken for another; whether it is."""

    def _ask(self, request: RequestT) -> bytes | None:
        """One attempt; None without a usable reply in time."""
        self.counts.requests += 1
        payload = self._exchange(*self._sent(request))
        self.counts.unanswered += payload is None
        return payload

    def _exchange(self, data: bytes, search: Search) -> bytes | None:
        try:
            self._port.drop_received()
            if not self._port.send(data):
                return None
            end = time.monotonic() + ANSWER_TIME
            while time.monotonic() < end:
                payload = search.feed(self._port.receive())
                if payload is not None:
                    return payload
                if search.over:
                    break
            if search.refusal:
                raise self._refused(search.refusal)
            return None
        finally:
            self.counts.corrupt += search.corrupt

    def _refused(self, what: str) -> DeviceError:
        return DeviceError(f"the hand refuses {what}: is it another model?", code="device.hand_refuses")

    def _silent(self, register: int, attempts: int = ATTEMPTS) -> NoAnswerError:
        message = f"no hand {self._hand_id} answers on {self._port.path} (register {register}, {attempts} attempts)"
        remedy = f"{self._look_at}, its number, and that hand.port is not another device's"
        return NoAnswerError(f"{message}: {remedy}", code="no_answer.hand_silent")

    _look_at: str
    """What a person is to check when it is silent."""
