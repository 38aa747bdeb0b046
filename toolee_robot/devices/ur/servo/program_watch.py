"""Ending the robot's program through the dashboard server, also from a process that outlives the servo process."""

from __future__ import annotations

import errno
import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from typing import Final

from toolee_robot.devices.ur.protocols.tcp import DASHBOARD_PORT, DashboardReader, connect, receive, send
from toolee_robot.errors import DeviceError

RETRY: Final = 0.2  # [s] on the wall clock between two requests
CONNECT: Final = 0.02  # [s] on the wall clock between two looks at a connection that is being made
TRIES: Final = 3  # requests on one connection, before a new one
SPARES: Final = 4  # sockets for new connections, made in advance: the servo process may open none later
_STOP = b"stop\n"


class ProgramStop:
    """A connection to the dashboard server that is kept open, so that a stop is one packet and needs no waiting.

    Args:
        host: Address of the controller.
        deadline: Deadline of connecting [s], a value of `time.monotonic()`.

    Raises:
        NoAnswerError: The dashboard server does not answer.
    """

    def __init__(self, host: str, deadline: float) -> None:
        self._socket = connect(host, DASHBOARD_PORT, deadline)
        self._address = self._socket.getpeername()
        self._socket.setblocking(False)
        self._spares = [socket.socket(socket.AF_INET, socket.SOCK_STREAM) for _ in range(SPARES)]
        self._connected, self._tries, self._next = True, 0, 0.0

    def request(self) -> None:
        """Ask for the end of the program; to be called in every cycle until the robot's state shows that it has ended.

        The request is repeated every RETRY seconds, on a new connection if the old one is lost or silent. Never waits.
        """
        now = time.monotonic()
        if now < self._next:
            return
        if not self._connected:
            self._connected = self._socket.connect_ex(self._address) in (0, errno.EISCONN)
        if self._connected and (self._tries >= TRIES or not self._send()):
            self._replace()
        self._next = now + (RETRY if self._connected else CONNECT)

    def _send(self) -> bool:
        """Whether the request could be handed to a connection that is not closed."""
        self._tries += 1
        try:
            with suppress(BlockingIOError):
                if not self._socket.recv(4096):  # greetings and answers: the robot's state tells more
                    return False
            self._socket.send(_STOP)
        except OSError:
            return False
        return True

    def _replace(self) -> None:
        """Begin a new connection, as long as there are sockets for it."""
        if self._spares:
            self._socket.close()
            self._socket = self._spares.pop()
            self._socket.setblocking(False)
            self._socket.connect_ex(self._address)
            self._connected, self._tries = False, 0


def end_program(host: str, timeout: float) -> bool:
    """End the robot's program from a process that has no connection; waits for the answer.

    Args:
        host: Address of the controller.
        timeout: Longest duration [s] on the wall clock.

    Returns:
        Whether the dashboard server has confirmed it.
    """
    deadline = time.monotonic() + timeout
    try:
        with connect(host, DASHBOARD_PORT, deadline) as sock:
            send(sock, _STOP, deadline)
            answers = b""
            while answers.count(b"\n") < 2:  # the greeting, and the answer
                answers += receive(sock, deadline)
    except DeviceError:
        return False
    return answers.split(b"\n")[1].strip() == b"Stopped"


PATIENCE: Final = 600.0
"""[s] on the wall clock for which the end of the program is asked for, as long as the dashboard does not confirm it."""
NOT_ENDED: Final = (
    "the dashboard server has not confirmed that the robot's program ended. If the robot has stopped too, stop the "
    "program at the pendant before you release the stop. Otherwise Play would move the arm on"
)

_ANSWER = 1.0  # [s] on the wall clock, for one attempt
_LOOK = 0.02  # [s] on the wall clock between two looks at the safety mode
_BEGUN, _ENDED = b"B", b"E"
_PROGRAM = "from toolee_robot.devices.ur.servo.program_watch import main; main()"


class ProgramWatch:
    """The watching process, for the task's process.

    Args:
        host: Address of the controller.
        delay: Time [s] on the wall clock from the servo process's end until the robot's program is ended: long enough
            for the robot's watchdog, with which a moving arm stops where it was sent last. An arm that the robot's
            safety system stops has its program ended at once.

    Attributes:
        fd: Descriptor that the servo process must inherit, and no other; see `WatchedProgram`.
    """

    def __init__(self, host: str, delay: float) -> None:
        self._host, self._delay, self._cancelled = host, delay, False
        read, self.fd = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, str(read), host, str(delay)],
            pass_fds=(read,),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        )
        os.close(read)

    def hand_over(self) -> None:
        """Close this process's copy of `fd`, once the servo process has it."""
        os.close(self.fd)

    def ended(self, timeout: float) -> bool:
        """Whether the robot's program has ended; to be called once the servo process is gone.

        Args:
            timeout: Longest wait for it [s] on the wall clock, beside the delay.

        Returns:
            Whether it has, never existed, or is no longer watched. If not, this process goes on trying.
        """
        if self._cancelled:
            return True
        try:
            code = self._process.wait(self._delay + timeout)
        except subprocess.TimeoutExpired:
            return False
        # Killed as well: what it would have done is left to this process.
        return code == 0 or end_program(self._host, timeout)

    def cancel(self) -> None:
        """Give up; before another program of this driver begins, which must not be ended. Idempotent."""
        self._cancelled = True
        self._process.kill()
        self._process.wait()


class WatchedProgram:
    """The servo process's notes for the watching process; never waits.

    Args:
        fd: Descriptor of `ProgramWatch`. That this process is gone shows by its closing.
    """

    def __init__(self, fd: int) -> None:
        self._fd = fd
        os.set_blocking(fd, False)

    def begun(self) -> None:
        """Note that this process's program runs on the robot."""
        self._write(_BEGUN)

    def ended(self) -> None:
        """Note that the robot has reported the program's end."""
        self._write(_ENDED)

    def _write(self, note: bytes) -> None:
        with suppress(OSError):  # the watching process was killed
            os.write(self._fd, note)


def main() -> None:
    """Watch until the program has ended; exits with 0 if it has.

    Command-line arguments: descriptor of the servo process's notes, host, delay [s].
    """
    fd, host, delay = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    exists = False
    while note := os.read(fd, 1):
        exists = note == _BEGUN
        if note == _ENDED:
            return
    if not exists:
        return
    give_up = time.monotonic() + PATIENCE
    _await_watchdog(host, time.monotonic() + delay)
    while not end_program(host, _ANSWER):
        if time.monotonic() > give_up:
            sys.exit(1)
        time.sleep(RETRY)


def _await_watchdog(host: str, deadline: float) -> None:
    """Wait until `deadline` [s], a value of `time.monotonic()`, or until the robot's safety system stops the arm."""
    with suppress(DeviceError), connect(host, DASHBOARD_PORT, deadline) as sock:
        reader = DashboardReader(sock, deadline)
        while time.monotonic() < deadline:
            mode = reader.ask("safetymode", deadline)
            if mode is not None and not mode.upper().endswith(("NORMAL", "REDUCED")):
                return
            time.sleep(_LOOK)
    time.sleep(max(deadline - time.monotonic(), 0.0))
