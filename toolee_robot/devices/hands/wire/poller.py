"""The thread that owns the line: it reads the hand's state all the time, and writes what it is told to."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import Generic, Protocol, TypeVar

from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock

PERIOD = 0.01
"""Shortest time between two readings [s]."""
COMMAND_TIME = 1.5
"""Longest time for a command, attempts included [s]."""


class Reading(Protocol):
    """What a hand said at one time, of its m motors in its own order."""

    @property
    def stamp(self) -> float:
        """Time at which it was asked [s]."""

    @property
    def number(self) -> int:
        """Number of the reading, from 1."""

    @property
    def closures(self) -> Array:
        """How far each motor is closed, (m,), in a unit of the hand's own; more is further closed."""

    @property
    def forces(self) -> Array:
        """Force of each motor's finger on what it touches, (m,), in a unit of the hand's own."""

    @property
    def fault(self) -> DeviceError | None:
        """The gravest fault that the hand reports."""


LineT = TypeVar("LineT")
ReadingT = TypeVar("ReadingT", bound=Reading)


class Poller(Generic[LineT, ReadingT]):
    """Reads the hand in a thread of its own from `start` to `close`.

    Args:
        line: The line, which from then on belongs to the thread.
        clock: The station's clock.
        read: Reads the hand; gets the line and the number of the reading.
        watch: Called with every reading in the thread; it may use the line.
    """

    def __init__(
        self,
        line: LineT,
        clock: Clock,
        read: Callable[[LineT, int], ReadingT],
        watch: Callable[[ReadingT, LineT], None],
    ) -> None:
        self._line, self._clock, self._read_line, self._watch = line, clock, read, watch
        self._news = threading.Condition()
        self._commands: deque[tuple[Callable[[LineT], None], Future[None]]] = deque()
        self._reading: ReadingT | None = None
        self._failure: DeviceError | None = None
        self._silence: DeviceError | None = None
        self._over = False
        self._thread = threading.Thread(target=self._run, name="hand", daemon=True)

    def start(self) -> None:
        """Read once, then go on in the thread.

        Raises:
            DeviceError: The hand does not answer, or is another one.
        """
        self._reading = self._read_line(self._line, 1)
        self._thread.start()

    def close(self) -> None:
        """End the thread, after the commands that wait."""
        with self._news:
            self._over = True
            self._news.notify_all()
        if self._thread.ident is not None:
            self._thread.join(2.0 * COMMAND_TIME)

    def run(self, command: Callable[[LineT], None]) -> None:
        """Let the thread carry out a command, and wait for it.

        Args:
            command: Uses the line.

        Raises:
            NoAnswerError: The hand does not answer, or its port is gone.
            DeviceError: The command failed otherwise, or the hand is closed.
        """
        done: Future[None] = Future()
        with self._news:
            self._check()
            self._commands.append((command, done))
            self._news.notify_all()
        try:
            done.result(COMMAND_TIME)
        except FutureTimeoutError:
            message = "the hand did not take a command in time: look at its cable"
            raise NoAnswerError(message, code="no_answer.hand_silent") from None

    def newest(self, max_age: float) -> ReadingT:
        """Return the newest reading.

        Args:
            max_age: Its largest age [s].

        Raises:
            StaleDataError: It is older.
            DeviceError: The port is gone, or the hand is closed.
        """
        with self._news:
            self._check()
            assert self._reading is not None
            reading, why = self._reading, self._silence
        age = self._clock.now() - reading.stamp
        if age > max_age:
            message = f"the hand's newest state is {age:.2f} s old: {why or 'its line is busy'}"
            raise StaleDataError(message, code="stale_data.hand") from why
        return reading

    def wait(self, after: int, timeout: float) -> ReadingT:
        """Wait for a reading later than the one with this number.

        Args:
            after: Number of a reading.
            timeout: Longest wait [s].

        Returns:
            The newest reading.

        Raises:
            StaleDataError: None came in time.
            DeviceError: The port is gone, or the hand is closed.
        """
        with self._news:
            self._news.wait_for(lambda: self._ended or self._number > after, timeout)
            self._check()
            assert self._reading is not None
            if self._number <= after:
                message = f"the hand has sent no state for {timeout:.2f} s: {self._silence or 'its line is busy'}"
                raise StaleDataError(message, code="stale_data.hand") from self._silence
            return self._reading

    @property
    def _number(self) -> int:
        return 0 if self._reading is None else self._reading.number

    @property
    def _ended(self) -> bool:
        return self._over or self._failure is not None

    def _check(self) -> None:
        if self._failure is not None:
            raise type(self._failure)(str(self._failure), code=self._failure.code) from self._failure
        if self._over:
            raise DeviceError("the hand is closed: use it inside its `with` block", code="device.closed")

    def _run(self) -> None:
        try:
            due = time.monotonic()  # a simulated clock may stand still, a hand must be asked on
            while True:
                self._carry_out()
                if self._over:
                    return
                self._poll()
                due = max(due + PERIOD, time.monotonic() - PERIOD)  # what is missed is not made up for
                with self._news:
                    self._news.wait_for(lambda: self._over or self._commands, due - time.monotonic())
        except DeviceError as error:
            self._fail(error)
        except BaseException as error:
            self._fail(DeviceError(f"the hand's driver failed: {error!r}", code="device.hand_driver"))
            raise

    def _poll(self) -> None:
        assert self._reading is not None
        try:
            reading = self._read_line(self._line, self._reading.number + 1)
            with self._news:
                self._reading, self._silence = reading, None
                self._news.notify_all()
            self._watch(reading, self._line)
        except NoAnswerError as error:
            if error.code == "no_answer.hand_unplugged":
                raise
            self._silence = error  # readings grow old, which whoever asks for one is told

    def _carry_out(self) -> None:
        while True:
            with self._news:
                if not self._commands:
                    return
                command, done = self._commands.popleft()
            try:
                command(self._line)
                done.set_result(None)
            except DeviceError as error:
                done.set_exception(error)
                if error.code == "no_answer.hand_unplugged":
                    raise

    def _fail(self, error: DeviceError) -> None:
        with self._news:
            self._failure = error
            waiting, self._commands = self._commands, deque()
            self._news.notify_all()
        for _, done in waiting:
            done.set_exception(error)
