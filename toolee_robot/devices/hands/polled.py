"""The base of every hand on a wire: one thread owns the wire, reads the hand all the time and writes what it is told.

A hand says how it is connected, read, watched and frozen; the base has readings and their age, motions, stop and state.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import contextmanager, suppress
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from toolee_robot.devices.hands.grip import Grip, GripRule, Reading, SaidT
from toolee_robot.devices.hands.ports import LineCounts
from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, HandState
from toolee_robot.robots import HandModel
from toolee_robot.types import JointState

MOTION_S = 8.0
"""Time for a motion where nobody says another."""
PERIOD_S = 0.01
"""Shortest time between two readings."""
COMMAND_S = 1.5
"""Longest time for a command, attempts included."""
RECENT_S = 0.1
"""Time over which speeds are taken."""
STANDS_S = 0.1
"""Time without motion after which a motor stands."""
COMMAND_DELAY_S = 0.1
"""Time after a command within which its motion has begun: 66 ms were measured on an Inspire RH56."""
SILENCE_S = 0.3
"""Longest time without a reading in a motion."""
UNPLUGGED = "no_answer.hand_unplugged"
"""Code of a port that is gone for good."""


class Line(Protocol):
    """The line to a hand."""

    counts: LineCounts

    def close(self) -> None:
        """Release the port."""


LineT = TypeVar("LineT", bound=Line)


class PolledHand(ABC, Generic[LineT, SaidT]):
    """A `hal.Hand` on a wire; use it in its `with` block. Entering it moves nothing.

    Args:
        model: The hand: `hand_model(config.hand)`.
        clock: Clock of the station, the host's.
        rule: What is a grip.
        still: Way of a motor that counts as none, in the unit of `Reading.closures`.

    Attributes:
        readings: Number of readings so far.
    """

    blocked = "something blocks the hand"
    """What a finger that does not move means, for people."""

    def __init__(self, model: HandModel, clock: Clock, rule: GripRule, still: float) -> None:
        self._model, self._clock, self._rule, self._still = model, clock, rule, still
        self._line: LineT | None = None
        self._moving, self._stopped = threading.Lock(), threading.Event()
        self._news = threading.Condition()
        self._thread: threading.Thread | None = None
        self._forget()

    def _forget(self) -> None:
        self.readings, self._over = 0, False
        self._grip = Grip(self._rule)
        self._recent: tuple[Reading[SaidT], ...] = ()
        self._commands: deque[tuple[Callable[[LineT], None], Future[None]]] = deque()
        self._failure: DeviceError | None = None
        self._silence: DeviceError | None = None

    def __enter__(self) -> Self:
        """Open the port and read the hand once.

        Raises:
            NoAnswerError: The port cannot be opened, or no hand answers.
            ProtocolError: What answers is no such hand.
        """
        self._forget()
        line = self._line = self._connect()
        try:
            self._take(self._read(line))
        except BaseException:
            line.close()
            raise
        self._thread = threading.Thread(target=self._run, args=(line,), name="hand", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the fingers, which keep what they hold, and release the port."""
        if self._thread is None or self._line is None:
            return
        with suppress(DeviceError):  # a hand that is out of reach cannot be stopped, and keeps its grip
            self.stop()
        with self._news:
            self._over = True
            self._news.notify_all()
        self._thread.join(2.0 * COMMAND_S)
        self._thread = None
        self._line.close()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the model's joints; a motor moves one or several of them."""
        return self._model.joints

    @property
    def line_counts(self) -> LineCounts:
        """What happened on the line so far."""
        return LineCounts() if self._line is None else self._line.counts

    def reading(self, max_age: float = 0.1) -> Reading[SaidT]:
        """Return the newest reading as the hand gave it.

        Args:
            max_age: Its largest age [s].

        Raises:
            StaleDataError: The hand has been silent for longer than `max_age`.
            NoAnswerError: Its port is gone.
            DeviceError: It is closed.
        """
        with self._news:
            self._check()
            reading, why = self._recent[-1], self._silence
        age = self._clock.now() - reading.stamp
        if age > max_age:
            message = f"the hand's newest state is {age:.2f} s old: {why or 'its line is busy'}"
            raise StaleDataError(message, code="stale_data.hand") from why
        return reading

    def state(self, max_age: float = 0.1) -> HandState:
        """Return the newest state; it may be asked from any thread at any time.

        Args:
            max_age: Largest age of the reading [s].

        Raises:
            StaleDataError: The hand has been silent for longer than `max_age`.
            NoAnswerError: Its port is gone.
            DeviceError: It is closed.
        """
        reading = self.reading(max_age)
        first = self._recent[0]
        q = self._positions(reading)
        qd = (q - self._positions(first)) / max(reading.stamp - first.stamp, RECENT_S)
        fault = ", ".join(filter(None, (reading.trouble, *self._troubles(), self._grip.slipped)))
        return HandState(
            JointState(q, qd, reading.stamp), self._newtons(reading), self._grip.holding,
            temperature=reading.temperature, fault=fault,
        )  # fmt: skip

    def stop(self) -> None:
        """Stop the fingers where they are; one that presses goes on pressing. `open` and `close` end with an error."""
        self._stopped.set()
        if self._thread is not None:
            self._tell(self._freeze)

    def open(self, timeout: float = MOTION_S) -> None:
        """Open the hand, whatever is wrong with it: a person waits for the tool.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out, something blocks a finger, a motor has a fault, the hand does not take
                commands, or `stop` ended it.
        """
        with self._motion(timeout) as reading:
            self._grip.end()
            reading, short = self._spread(reading)
            if short:
                reading.refuse_fault()
                message = f"{self.blocked}: {', '.join(short)} did not open. Check the hand"
                raise DeviceError(message, code="device.hand_blocked")

    def close(self, timeout: float = MOTION_S) -> None:
        """Close the hand until it holds something or is shut.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out, a motor has a fault, a finger does not move, the hand does not take
                commands, or `stop` ended it; the hand keeps its grip.
        """
        with self._motion(timeout) as reading:
            reading.refuse_fault()
            self._grip.end()
            reading, stuck = self._grasp(reading)
            if stuck:
                message = f"{self.blocked}: {', '.join(stuck)} did not close. Check the hand"
                raise DeviceError(message, code="device.hand_stall")
            self._grip.begin(reading)

    @abstractmethod
    def _spread(self, reading: Reading[SaidT]) -> tuple[Reading[SaidT], list[str]]:
        """Move to the open hand; the reading then, and the names of what did not open."""

    @abstractmethod
    def _grasp(self, reading: Reading[SaidT]) -> tuple[Reading[SaidT], list[str]]:
        """Move until the hand holds or is shut; the reading for the grip, and the names of what did not close."""

    @abstractmethod
    def _connect(self) -> LineT:
        """Open the line."""

    @abstractmethod
    def _read(self, line: LineT) -> Reading[SaidT]:
        """Read the hand; in the thread, but for the first time (`readings` is 0)."""

    @abstractmethod
    def _watch(self, reading: Reading[SaidT], line: LineT) -> None:
        """Judge the grip with every reading, and keep it up; in the thread."""

    @abstractmethod
    def _freeze(self, line: LineT) -> None:
        """Stop the motors; in the thread."""

    @abstractmethod
    def _positions(self, reading: Reading[SaidT]) -> Array:
        """Positions of the model's joints, (n,) [rad]."""

    @abstractmethod
    def _newtons(self, reading: Reading[SaidT]) -> dict[str, float]:
        """Force of each finger [N]."""

    def _troubles(self) -> tuple[str, ...]:
        """What is wrong besides what a reading says, for people."""
        return ()

    def _speeds(self) -> Array:
        """Speeds of the motors' closures over the last RECENT_S, (m,), per second."""
        first, now = self._recent[0], self._recent[-1]
        return np.asarray((now.closures - first.closures) / max(now.stamp - first.stamp, RECENT_S))

    @contextmanager
    def _motion(self, timeout: float) -> Iterator[Reading[SaidT]]:
        """Context of one motion, of which there is one at a time; gives the newest reading."""
        end, reading = self._clock.now() + timeout, self.reading(SILENCE_S)
        if not self._moving.acquire(blocking=False):
            raise DeviceError("the hand is moving: wait for its motion to end", code="device.busy")
        try:
            self._stopped.clear()
            self._end, self._timeout = end, timeout
            yield reading
        finally:
            self._moving.release()

    def _until_still(
        self, motor: int | None = None, settled: Callable[[Reading[SaidT]], bool] = lambda _: True
    ) -> Reading[SaidT]:
        """Wait until the motors stand, whatever state they report: one that was stuck said that it had arrived.

        Args:
            motor: The only one to wait for; None for all.
            settled: Whether motors that stand have done what they shall, by a reading.

        Returns:
            The newest reading.

        Raises:
            DeviceError: The motion timed out, or was stopped, or a motor has got a fault.
            StaleDataError: The hand has fallen silent.
        """
        index = slice(None) if motor is None else motor
        reading = self.reading(SILENCE_S)
        had = str(reading.fault)
        since, reference = self._clock.now() + COMMAND_DELAY_S, reading.closures
        while True:
            reading = self._next()
            if str(reading.fault) != had:
                reading.refuse_fault()
            if self._stopped.is_set():
                raise DeviceError("the hand was stopped; it keeps its grip")
            if np.max(np.abs(reading.closures - reference)[index]) > self._still:
                reference, since = reading.closures, max(since, reading.stamp)
            elif reading.stamp - since >= STANDS_S and settled(reading):
                return reading
            if self._clock.now() > self._end:
                self._tell(self._freeze)
                message = f"the hand did not finish within {self._timeout:.1f} s; it keeps its position and its grip"
                raise DeviceError(message, code="device.timeout")

    def _tell(self, command: Callable[[LineT], None]) -> None:
        """Let the thread carry out a command with the line, and wait for it."""
        done: Future[None] = Future()
        with self._news:
            self._check()
            self._commands.append((command, done))
            self._news.notify_all()
        try:
            done.result(COMMAND_S)
        except FutureTimeoutError:
            message = "the hand did not take a command in time. Check its cable"
            raise NoAnswerError(message, code="no_answer.hand_silent") from None

    def _next(self) -> Reading[SaidT]:
        """Wait for a reading later than the newest, for SILENCE_S at most."""
        with self._news:
            self._check()
            known = self.readings
            self._news.wait_for(lambda: self._over or self._failure or self.readings > known, SILENCE_S)
            self._check()
            if self.readings == known:
                message = f"the hand has sent no state for {SILENCE_S:.2f} s: {self._silence or 'its line is busy'}"
                raise StaleDataError(message, code="stale_data.hand") from self._silence
            return self._recent[-1]

    def _check(self) -> None:
        if self._failure is not None:
            raise type(self._failure)(str(self._failure), code=self._failure.code) from self._failure
        if self._thread is None or self._over:
            raise DeviceError("the hand is closed: use it inside its `with` block", code="device.closed")

    def _take(self, reading: Reading[SaidT]) -> None:
        with self._news:
            kept = (old for old in self._recent if reading.stamp - old.stamp <= RECENT_S)
            self._recent, self._silence = (*kept, reading), None
            self.readings += 1
            self._news.notify_all()

    def _run(self, line: LineT) -> None:
        try:
            due = time.monotonic()  # a simulated clock may stand still, a hand must be asked on
            while True:
                self._carry_out(line)
                if self._over:
                    return
                self._poll(line)
                due = max(due + PERIOD_S, time.monotonic() - PERIOD_S)  # what is missed is not made up for
                with self._news:
                    self._news.wait_for(lambda: self._over or self._commands, due - time.monotonic())
        except DeviceError as error:
            self._fail(error)
        except BaseException as error:
            self._fail(DeviceError(f"the hand's driver failed: {error!r}"))
            raise

    def _poll(self, line: LineT) -> None:
        try:
            reading = self._read(line)
            self._take(reading)
            self._watch(reading, line)
        except NoAnswerError as error:
            if error.code == UNPLUGGED:
                raise
            self._silence = error  # readings grow old, which whoever asks for one is told

    def _carry_out(self, line: LineT) -> None:
        while True:
            with self._news:
                if not self._commands:
                    return
                command, done = self._commands.popleft()
            try:
                command(line)
                done.set_result(None)
            except DeviceError as error:
                done.set_exception(error)
                if error.code == UNPLUGGED:
                    raise

    def _fail(self, error: DeviceError) -> None:
        with self._news:
            self._failure = error
            waiting, self._commands = self._commands, deque()
            self._news.notify_all()
        for _, done in waiting:
            done.set_exception(error)
