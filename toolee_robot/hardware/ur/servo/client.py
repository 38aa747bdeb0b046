"""The task's side of the servo process: start it, show it that the task lives, send it requests, and never wait for it
longer than agreed."""

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

from toolee_robot.errors import DeviceError, NotReadyError, ServoCrashError
from toolee_robot.hardware.ur.config import UrArmConfig
from toolee_robot.hardware.ur.servo.clock import Realtime
from toolee_robot.hardware.ur.servo.messages import Close, Connect, Connected, Refused, Reply, Request
from toolee_robot.hardware.ur.servo.shared_memory import ServoMemory, Word

HEARTBEAT_PERIOD: Final = 0.01  # [s]
START_TIMEOUT: Final = 15.0
"""[s] of the wall. For Python and numpy in the new process: the host's matter, not the robot's."""
MORE: Final = 1.0
"""[s] of the wall. The servo process ends itself when the robot does not answer in time; so much later it is killed."""
_LAST_WORDS: Final = 600  # characters

_PROGRAM = "from toolee_robot.hardware.ur.servo.process import main; main()"


class ServoClient:
    """A running servo process, connected to the robot. realtime: what the system granted it. memory: shared with it."""

    def __init__(self, config: UrArmConfig, rate: float) -> None:
        """Start and connect. Raises NotReadyError when the robot must be made ready first, DeviceError when it refuses,
        ServoCrashError when the process dies or hangs meanwhile."""
        self._config, self._clock = config, config.clock
        self.memory = ServoMemory.create(config.longest_motion)
        ours, theirs = socket.socketpair()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  (its reader is the message of a crash, later)
        # A fresh interpreter, in a session of its own: no Ctrl-C of the terminal reaches it, and none of the task's
        # threads, locks and libraries are in it.
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, str(theirs.fileno()), str(self.memory.fd), str(config.longest_motion)],
            pass_fds=(theirs.fileno(), self.memory.fd),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OMP_NUM_THREADS": "1"},
        )
        theirs.close()
        self.memory.close()
        self._pipe = Connection(ours.detach())
        self._beats, self._ended = threading.Event(), threading.Event()
        threading.Thread(target=self._beat, name="arm heartbeat", daemon=True).start()
        self._beats.wait()
        try:
            self.realtime = self._connect(rate)
        except BaseException:
            self.kill()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def cycles_within(self, timeout: float) -> bool:
        """Whether its loop does another cycle within so long [s]; comes back as soon as it has."""
        done, deadline = int(self.memory.words[Word.CYCLES]), self._clock.now() + timeout
        while int(self.memory.words[Word.CYCLES]) == done:
            if self._clock.now() > deadline:
                return False
            time.sleep(1e-3)
        return True

    def ask_to_stop(self) -> None:
        """Brake in the next cycle; any thread."""
        self.memory.words[Word.STOP] += 1

    def ask(self, request: Request) -> Reply:
        """A short request and its reply. Raises DeviceError when refused, ServoCrashError when there is no answer."""
        self.send(request)
        # The payload is acknowledged, then read back.
        reply = self.receive(self._clock.to_wall_time(2 * self._config.handshake_timeout) + MORE)
        if reply is None:
            raise self.crash(hung=True)
        if isinstance(reply, Refused):
            raise (NotReadyError if reply.not_ready else DeviceError)(reply.message)
        return reply

    def send(self, request: Request) -> None:
        try:
            self._pipe.send(request)
        except OSError as error:
            raise self.crash() from error

    def receive(self, timeout: float) -> Reply | None:
        """The next answer, or None after `timeout` [s] of the wall. Raises ServoCrashError when the process is gone."""
        try:
            if not self._pipe.poll(timeout):
                return None
            reply: Reply = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise self.crash() from error
        return reply

    def crash(self, hung: bool = False) -> ServoCrashError:
        """The error for a process that is gone, or hangs, with its last words; makes sure that it is gone."""
        if hung:
            self._process.send_signal(signal.SIGABRT)  # it then says where it is
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(0.2)
        code = self._process.poll()
        self.kill()
        how = "hung" if hung or code is None else f"ended with code {code}" if code >= 0 else _signal_name(-code)
        self._errors.seek(0)
        words = self._errors.read().decode(errors="replace").split("Extension modules")[0].strip()[-_LAST_WORDS:]
        return ServoCrashError(
            f"the process that talks to the arm {how}; the robot's watchdog stops the arm. See to it, then reset"
            + (f" (its last words: {words})" if words else "")
        )

    def close(self) -> None:
        """End the robot's program and the process; kill what does not end in time."""
        with suppress(DeviceError):
            self.send(Close())
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(self._clock.to_wall_time(self._config.handshake_timeout) + MORE)
        self.kill()

    def kill(self) -> None:
        """End the process at once; the kernel closes its connections. Any number of times."""
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
                    "the robot did not answer while it was connected to: check the network, then reset"
                    if self.memory.words[Word.CONNECTING]
                    else "the servo process did not start: the machine is overloaded"
                )
            if started := int(self.memory.words[Word.CONNECTING]):
                deadline = min(deadline, started * 1e-9 + self._clock.to_wall_time(self._config.connect_timeout) + MORE)
        if isinstance(reply, Refused):
            raise (NotReadyError if reply.not_ready else DeviceError)(reply.message)
        if not isinstance(reply, Connected):
            raise ServoCrashError(f"the servo process answered {reply!r} to Connect")
        return reply.realtime

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
