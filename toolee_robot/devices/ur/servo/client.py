"""The task's side of the servo process: starts it, sends it heartbeats and requests, and bounds every wait for it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Final

from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.servo.clock import Realtime
from toolee_robot.devices.ur.servo.messages import (
    Cause,
    Close,
    Connect,
    Connected,
    MotionEnded,
    MotionRequest,
    Refused,
    Reply,
    Request,
)
from toolee_robot.devices.ur.servo.program_watch import NOT_ENDED, ProgramWatch
from toolee_robot.devices.ur.servo.shared_memory import ServoMemory, Word
from toolee_robot.errors import DeviceError, MotionFaultError, ServoCrashError

HEARTBEAT_PERIOD: Final = 0.01  # [s]
START_TIMEOUT: Final = 15.0
"""[s] on the wall clock, for loading Python and numpy in the new process; independent of the robot."""
KILL_MARGIN: Final = 1.0
"""[s] on the wall clock. The servo process ends itself when the robot does not answer in time; if it does not, it is
killed this much later."""
_POLL: Final = 0.02  # [s] between two checks that the servo loop runs
_STDERR_TAIL: Final = 600  # characters of the servo process's error output in a crash's message

_PROGRAM = "from toolee_robot.devices.ur.servo.process import main; main()"


class ServoClient:
    """A running servo process, connected to the robot.

    Args:
        config: The driver's settings.
        rate: The controller's rate [Hz].

    Attributes:
        memory: Memory shared with the servo process.
        realtime: Real-time privileges that the operating system granted to it.

    Raises:
        NotReadyError: The robot must be made ready first.
        DeviceError: The robot refuses the connection.
        ServoCrashError: The process died or hung while it connected.
    """

    def __init__(self, config: UrArmConfig, rate: float) -> None:
        self._config, self._clock = config, config.clock
        self.memory = ServoMemory.create(config.longest_motion)
        ours, theirs = socket.socketpair()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  (read later, for a crash's message)
        self._watch = ProgramWatch(config.host, self._clock.to_wall_time(2.0 / config.servo.watchdog))
        fd = self._watch.fd
        # A fresh interpreter in its own session: the terminal's Ctrl-C does not reach it, and it inherits none of the
        # task's threads, locks and libraries.
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, *map(str, (theirs.fileno(), self.memory.fd, config.longest_motion, fd))],
            pass_fds=(theirs.fileno(), self.memory.fd, fd),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OMP_NUM_THREADS": "1"},
        )
        theirs.close()
        self._watch.hand_over()
        self.memory.close()
        self._pipe = Connection(ours.detach())
        self._beats, self._ended = threading.Event(), threading.Event()
        threading.Thread(target=self._beat, name="arm heartbeat", daemon=True).start()
        self._beats.wait()
        try:
            self.realtime = self._connect(rate)
        except BaseException:
            self.kill()
            self.program_ended()
            raise

    @property
    def pid(self) -> int:
        """Process id of the servo process."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the servo process exists."""
        return self._process.poll() is None

    def cycles_within(self, timeout: float) -> bool:
        """Whether the servo loop completes another cycle within `timeout` [s]; returns as soon as it has."""
        done, deadline = int(self.memory.words[Word.CYCLES]), self._clock.now() + timeout
        while int(self.memory.words[Word.CYCLES]) == done:
            if self._clock.now() > deadline:
                return False
            time.sleep(1e-3)
        return True

    def ask_to_stop(self) -> None:
        """Request a path stop in the next cycle; callable from any thread."""
        self.memory.words[Word.STOP] += 1

    def ask(self, request: Request) -> Reply:
        """Send a request other than a motion and wait for its reply.

        Raises:
            DeviceError: The robot or the servo process refused it.
            ServoCrashError: There was no reply in time.
        """
        self.send(request)
        # The payload is acknowledged, then read back.
        reply = self.receive(self._clock.to_wall_time(2 * self._config.servo.handshake_timeout) + KILL_MARGIN)
        if reply is None:
            raise self.crash(hung=True)
        if isinstance(reply, Refused):
            raise reply.error()
        return reply

    def send(self, request: Request) -> None:
        """Send a request without waiting. Raises ServoCrashError if the process is gone."""
        try:
            self._pipe.send(request)
        except OSError as error:
            raise self.crash() from error

    def receive(self, timeout: float) -> Reply | None:
        """The next reply, or None after `timeout` [s] on the wall clock.

        Raises:
            ServoCrashError: The process is gone.
        """
        try:
            if not self._pipe.poll(timeout):
                return None
            reply: Reply = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise self.crash() from error
        return reply

    def execute(self, request: MotionRequest) -> Cause:
        """Execute the path in the shared memory and wait for its end while the servo loop keeps running.

        Args:
            request: The motion's parameters.

        Returns:
            Why the motion ended.

        Raises:
            ServoCrashError: The servo process died or hung.
        """
        try:
            self.send(request)
            return self._await_end()
        except BaseException as error:
            # Ctrl-C, or any other exception in this thread: bring the arm to a standstill before raising it.
            if not isinstance(error, MotionFaultError):
                self.ask_to_stop()
                self._await_end()
            raise

    def crash(self, hung: bool = False) -> ServoCrashError:
        """Kill the servo process if it still runs, and build the error that describes its end.

        Args:
            hung: Whether it is to be treated as hung; it is made to print its stack traces first.

        Returns:
            The error, with the end of the process's error output.
        """
        if hung:
            self._process.send_signal(signal.SIGABRT)  # faulthandler prints the stack traces
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(0.2)
        code = self._process.poll()
        self.kill()
        ended = self.program_ended()
        how = "hung" if hung or code is None else f"ended with code {code}" if code >= 0 else _signal_name(-code)
        self._errors.seek(0)
        words = self._errors.read().decode(errors="replace").split("Extension modules")[0].strip()[-_STDERR_TAIL:]
        return ServoCrashError(
            f"the servo process {how}; the robot's watchdog stops the arm. Look at the robot, then reset the arm"
            + ("" if ended else f"; {NOT_ENDED}")
            + (f" (the process's error output: {words})" if words else "")
        )

    def program_ended(self) -> bool:
        """Whether the robot's program has ended, after the servo process has; waits for it, a bounded time.

        If not, the dashboard server is asked for its end in the background until it confirms it.
        """
        return self._watch.ended(self._clock.to_wall_time(self._config.servo.handshake_timeout))

    def forget_program(self) -> None:
        """No longer ask for the end of this client's program, before another begins. Idempotent."""
        self._watch.cancel()

    def close(self) -> bool:
        """End the robot's program and the servo process, which is killed if it does not end in time.

        Returns:
            Whether the program has ended; see `program_ended`.
        """
        with suppress(DeviceError):
            self.send(Close())
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(self._clock.to_wall_time(self._config.servo.handshake_timeout) + KILL_MARGIN)
        self.kill()
        return self.program_ended()

    def kill(self) -> None:
        """Kill the process; the kernel closes its connections. Idempotent."""
        self._ended.set()
        self._process.kill()
        self._process.wait()
        self._pipe.close()

    def _connect(self, rate: float) -> Realtime:
        self.send(Connect(self._config, rate))
        deadline = time.monotonic() + START_TIMEOUT
        while (reply := self.receive(0.05)) is None:
            if time.monotonic() > deadline:
                raise ServoCrashError(
                    "the robot did not answer while connecting: check the network, then reset"
                    if self.memory.words[Word.CONNECTING]
                    else "the servo process did not start: the machine is overloaded"
                )
            if started := int(self.memory.words[Word.CONNECTING]):
                connecting = self._clock.to_wall_time(self._config.servo.connect_timeout)
                deadline = min(deadline, started * 1e-9 + connecting + KILL_MARGIN)
        if isinstance(reply, Refused):
            raise reply.error()
        if not isinstance(reply, Connected):
            raise ServoCrashError(f"the servo process answered {reply!r} to Connect")
        return reply.realtime

    def _await_end(self) -> Cause:
        cycles, since = -1, self._clock.now()
        while True:
            reply = self.receive(_POLL)
            if isinstance(reply, MotionEnded):
                return reply.cause
            if reply is not None:
                self.kill()
                message = f"the servo process answered {reply!r} to a motion: reset the arm"
                raise ServoCrashError(message)
            now, done = self._clock.now(), int(self.memory.words[Word.CYCLES])
            if done != cycles:
                cycles, since = done, now
            elif now - since > self._config.servo.hang_timeout:
                raise self.crash(hung=True)

    def _beat(self) -> None:
        try:
            self.memory.owner.hold()
        finally:
            self._beats.set()
        while not self._ended.wait(self._clock.to_wall_time(HEARTBEAT_PERIOD)):
            self.memory.words[Word.HEARTBEAT] += 1


def _signal_name(number: int) -> str:
    try:
        name = signal.Signals(number).name
    except ValueError:
        name = f"signal {number}"
    return "did not answer in time" if name == "SIGALRM" else f"died of {name}"
